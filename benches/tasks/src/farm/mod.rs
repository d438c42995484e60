//! `./x farm`: many rows on a real Slurm and in a real OpenJD runner, with workers that are killed, starved of room and
//! of the right time, and in large numbers.

mod chaos;
mod clock;
mod cluster;
mod disk;
mod figures;
mod models;
mod openjd;
mod random;
mod running;
mod scale;
mod site;
mod slurm;
pub(crate) mod task;
mod trial;
