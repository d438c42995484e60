//! `guard4d verify`

use std::path::PathBuf;

use guard4d_engine::EngineError;
use guard4d_engine::clip::ClipSource;
use guard4d_engine::scene::Model;
use guard4d_engine::watermark::evidence::{PStatement, Verdict};
use guard4d_engine::watermark::key::Key;
use guard4d_engine::watermark::message::Payload;
use guard4d_engine::watermark::other_keys::OtherKeys;
use guard4d_engine::watermark::verify::{Case, Exhibits, Report, Stranger, clean_clips};

use crate::args::{Common, VerifyArgs};
use crate::devices;
use crate::media::read_options;
use crate::report::{Outcome, evidence_in_words, print, table};
use crate::views::cameras;

pub(crate) fn run(args: &VerifyArgs, common: &Common) -> Result<Outcome, EngineError> {
    let device = devices::open(common)?;
    let clip = devices::load_clip(&device, &ClipSource::from_argument(&args.clip), common)?;
    let key = Key::read(&args.key, &clip)?;
    let bits = u32::try_from(key.bits()).unwrap_or(u32::MAX);
    let message = Payload::parse(&args.message, bits)?.message(&key.prf())?;
    let clean = match &args.original {
        Some(path) => clean_clips(&device, &Model::open(path)?, &cameras(&args.views)?)?,
        None => Vec::new(),
    };
    let stranger = |path: &PathBuf| Ok(Stranger { name: path.display().to_string(), key: Key::read(path, &clip)? });
    let strangers = args.other_key.iter().map(stranger).collect::<Result<_, EngineError>>()?;
    let exhibits = Exhibits { suspects: args.clips.clone(), unrelated: args.unrelated.clone(), clean, strangers };
    let case = Case { device: &device, clip: &clip, key: &key, message, receipt: &args.receipt };
    let report = case.verify(&exhibits, &read_options())?;
    print(common, &report, human)?;
    Ok(outcome(&report))
}

pub(crate) fn outcome(report: &Report) -> Outcome {
    match report.evidence.verdict {
        Verdict::Present => Outcome::Done,
        Verdict::Absent => Outcome::Negative,
        Verdict::Inconclusive => Outcome::Inconclusive,
    }
}

pub(crate) fn human(report: &Report) -> String {
    let e = &report.evidence;
    let p = p_in_words(&e.p_value);
    let mut rows = vec![
        ("verdict", format!("{:?}", e.verdict).to_uppercase()),
        ("bits", format!("{} of {} match ({} frames)", e.matches, e.num_bits, report.frames)),
        ("evidence", evidence_in_words(e.mode).to_owned()),
        ("p-value", p),
        ("inverted message", format!("{} of {} match", e.panel.inverted.leak.matches, e.num_bits)),
        ("other keys' messages", other_keys_in_words(&e.panel.other_messages)),
        ("other keys' readings", other_keys_in_words(&e.panel.other_readings)),
    ];
    for control in &e.panel.supplied {
        rows.push((
            "control",
            format!("{}: {} of {} match", control.name, control.leak.matches, control.leak.num_bits),
        ));
    }
    if !e.panel.not_run.is_empty() {
        let kinds: Vec<String> = e.panel.not_run.iter().map(ToString::to_string).collect();
        rows.push(("controls not run", kinds.join(", ")));
    }
    for reason in &e.reasons {
        rows.push(("because", reason.to_string()));
    }
    for line in &report.damage {
        rows.push(("damaged", line.clone()));
    }
    table(&rows)
}

fn other_keys_in_words(keys: &OtherKeys) -> String {
    let OtherKeys { num_keys, most_matches, as_good, .. } = keys;
    format!("the best of {num_keys} throw-away keys matches {most_matches} bits; {as_good} do as well as the claim")
}

fn p_in_words(p: &PStatement) -> String {
    match p {
        PStatement::Exact { matches, soft_score } => {
            format!("{matches:.2e} exact, of the matches ({soft_score:.2e} of the soft score)")
        }
        PStatement::Empirical { false_positives, num_clips, bound } => {
            format!("none; {false_positives} of {num_clips} unrelated clips read as well, rate at most {bound:.3}")
        }
    }
}
