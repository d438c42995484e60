mod adam;
