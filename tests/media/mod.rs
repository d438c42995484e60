mod frames;
mod video;
