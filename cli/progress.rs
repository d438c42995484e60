//! The progress bar of long commands; silent when nobody watches.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::args::Common;

/// A bar of `len` steps with a message behind it.
pub(crate) fn bar(common: &Common, len: u64) -> ProgressBar {
    let target = if common.quiet { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
    let style = ProgressStyle::with_template("{bar:30} {pos}/{len} {elapsed_precise} ETA {eta} {wide_msg}");
    ProgressBar::with_draw_target(Some(len), target).with_style(style.expect("the template is a constant"))
}
