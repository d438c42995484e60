mod conv3d;
