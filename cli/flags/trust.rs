//! Whose dates are believed.

use std::path::PathBuf;

use clap::Args;

/// Whose dates are believed.
#[derive(Args, Debug)]
#[command(next_help_heading = "Date")]
pub(crate) struct TrustArgs {
    /// Certificates of a time-stamping authority that you trust, in PEM or DER; without one a date is only claimed
    ///
    /// The token's own certificate has to lead to one of them, and all on the way have to be valid at the token's date.
    /// Whether one was revoked is not asked.
    #[arg(long, value_name = "FILE")]
    pub(crate) ca: Vec<PathBuf>,
}
