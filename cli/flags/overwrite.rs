//! Whether an output may replace what is there.

use clap::Args;
use guard4d_engine::base::output::Existing;

/// Whether an output may replace what is there.
#[derive(Args, Debug)]
pub(crate) struct Overwrite {
    /// Replace what is there
    #[arg(short = 'w', long)]
    overwrite: bool,
}

impl Overwrite {
    pub(crate) const fn is_asked(&self) -> bool {
        self.overwrite
    }

    pub(crate) const fn existing(&self) -> Existing {
        if self.overwrite { Existing::Replace } else { Existing::Refuse }
    }
}
