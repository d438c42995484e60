mod bce;
