//! `guard4d keygen`

use guard4d_engine::EngineError;
use guard4d_engine::clip::{Clip, ClipSource};
use guard4d_engine::output::{AtomicFile, Existing};
use guard4d_engine::watermark::key::{Key, KeyReport, read_secret};

use crate::args::{Common, KeygenArgs};
use crate::devices;
use crate::report::{Outcome, note, print, table};

pub(crate) fn run(args: &KeygenArgs, common: &Common) -> Result<Outcome, EngineError> {
    let existing = if args.overwrite { Existing::Replace } else { Existing::Refuse };
    // Half a minute of training must not end at a place that cannot be written.
    drop(AtomicFile::create(&args.out, existing)?);
    let device = devices::open(common)?;
    let clip = Clip::load(&device, &ClipSource::from_argument(&args.clip))?;
    let secret = read_secret(args.secret.as_ref())?;
    let (key, report) = Key::generate(&device, &clip, secret, args.bits)?;
    key.write(&args.out, existing)?;
    print(common, &report, human)?;
    let kept = format!("wrote {}; keep it private: whoever has it can write and read your marks", args.out.display());
    note(common, &kept);
    Ok(Outcome::Done)
}

fn human(report: &KeyReport) -> String {
    let at = |i: usize| report.spectrum.0.get(i - 1).copied().unwrap_or(0.0);
    table(&[
        ("key id", report.key_id.clone()),
        ("bits", report.bits.to_string()),
        (
            "spectrum",
            format!(
                "{:.4} (1st)  {:.4} (8th)  {:.4} ({}th, the weakest needed)",
                at(1),
                at(8),
                at(report.bits),
                report.bits
            ),
        ),
        (
            "held-out messages",
            format!(
                "{:.3} % of bits, {:.2} % of messages",
                100.0 * report.held_out_accuracy,
                100.0 * report.held_out_exact
            ),
        ),
        ("seconds", format!("{:.1}", report.seconds)),
    ])
}
