mod mul_add;
