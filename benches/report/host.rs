//! The machine and the source that a run was made with, and where its results go.

use std::path::{Path, PathBuf};
use std::process::Command;

use guard4d_kernels::Device;

/// Load averages of the machine, where it tells them.
pub(crate) fn load() -> String {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split(' ').take(2).collect::<Vec<_>>().join(" ")
}

/// First line that a program prints in the repository, if any.
fn said(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).current_dir(env!("CARGO_MANIFEST_DIR")).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    text.lines().next().map(|line| line.trim().to_owned())
}

/// Name and threads of the processor.
pub(crate) fn processor() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = text.lines().find(|l| l.starts_with("model name")).and_then(|l| l.split(": ").nth(1));
    let threads = std::thread::available_parallelism().map_or(0, usize::from);
    format!("{}, {threads} threads", model.unwrap_or("unknown"))
}

/// Today in UTC.
pub(crate) fn date() -> String {
    said("date", &["-u", "+%F"]).unwrap_or_else(|| "undated".to_owned())
}

/// Commit of the source, and whether it was changed since.
pub(crate) fn commit() -> String {
    let commit = said("git", &["rev-parse", "HEAD"]).unwrap_or_else(|| "unknown".to_owned());
    let changed = if said("git", &["status", "--porcelain", "-uno"]).is_some() { " with local changes" } else { "" };
    format!("{commit}{changed}")
}

/// Letters and digits, the rest as single dashes.
fn slug(text: &str) -> String {
    let words = text.split(|c: char| !c.is_ascii_alphanumeric()).filter(|w| !w.is_empty());
    words.collect::<Vec<_>>().join("-").to_lowercase()
}

/// Folder of today's results on a device.
pub(crate) fn results(device: &Device) -> PathBuf {
    let name = format!("{}-{}", date(), slug(&device.info().name));
    Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/results").join(name)
}
