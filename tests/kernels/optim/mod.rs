mod adam;
mod neighbour_mean;
