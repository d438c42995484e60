//! Camera files and folders of other programs, told apart by their content; `open.rs` has the table of them.

mod camera_path;
mod colmap;
mod grouped;
mod inria;
mod nerfies;
mod open;
mod reader;
mod single;
mod transforms;
