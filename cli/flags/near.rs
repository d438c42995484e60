//! Where the cameras of films may have stood.

use std::path::PathBuf;

use clap::Args;

/// Places that are known.
#[derive(Args, Debug)]
pub(crate) struct NearArgs {
    /// Look for the film's cameras near those of this file or folder, inside of the scene
    ///
    /// For captures that nobody sees from outside: rooms, streets, landscapes. The cameras that the model was trained
    /// from will do, in any kind of file that --cameras takes. Unless given, cameras are looked for all around the
    /// model.
    #[arg(long, value_name = "PATH")]
    pub(crate) near: Option<PathBuf>,
}
