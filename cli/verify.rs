//! `guard4d verify`

use std::path::PathBuf;

use guard4d_engine::EngineError;
use guard4d_engine::clip::ClipSource;
use guard4d_engine::media::ReadOptions;
use guard4d_engine::media::framing::Rect;
use guard4d_engine::scene::Model;
use guard4d_engine::watermark::edits::Edit;
use guard4d_engine::watermark::evidence::{PStatement, Verdict};
use guard4d_engine::watermark::general::GeneralExtractor;
use guard4d_engine::watermark::id_code::{IdBits, SearchedP};
use guard4d_engine::watermark::key::Key;
use guard4d_engine::watermark::other_keys::OtherKeys;
use guard4d_engine::watermark::verify::{
    Case, ClipReading, Exhibits, IdEvidence, Progress, Report, Sought, Stranger, UndoneEdit, clean_clips,
};

use crate::args::{Common, VerifyArgs};
use crate::devices;
use crate::media::read_some;
use crate::progress::bar;
use crate::report::{Outcome, Row, evidence_in_words, percent, print, table};
use crate::views::cameras;

pub(crate) fn run(args: &VerifyArgs, common: &Common) -> Result<Outcome, EngineError> {
    let device = devices::open(common)?;
    let clip = devices::load_clip(&device, &ClipSource::from_argument(&args.clip), common)?;
    let key = Key::read(&args.key, &clip)?;
    let sought = args.message.as_ref().map(|text| Sought::parse(text, &key)).transpose()?;
    let clean = match &args.original {
        Some(path) => {
            let model = Model::open(path)?;
            clean_clips(&device, &model, &cameras(&args.views, &model)?)?
        }
        None => Vec::new(),
    };
    let stranger = |path: &PathBuf| Ok(Stranger { name: path.display().to_string(), key: Key::read(path, &clip)? });
    let strangers = args.other_key.iter().map(stranger).collect::<Result<_, EngineError>>()?;
    let (suspects, edits) = (args.clips.clone(), args.framing.edits());
    let exhibits = Exhibits { suspects, edits, unrelated: args.unrelated.clone(), clean, strangers };
    let general = args.general.as_deref().map(GeneralExtractor::read).transpose()?;
    let (receipt, general) = (&args.receipt, general.as_ref());
    let case = Case { device: &device, clip: &clip, key: &key, sought, receipt, general };
    let options = ReadOptions { framing: args.framing.framing(), ..read_some(&args.frames) };
    let progress = bar(common, 0);
    let report = case.verify_watched(&exhibits, &options, &mut |Progress { path, frames, expected }| {
        progress.set_length(expected.unwrap_or(frames).max(frames));
        progress.set_position(frames);
        if frames == 1 {
            progress.set_message(path.display().to_string());
        }
        Ok(())
    })?;
    progress.finish_and_clear();
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
        ("bit accuracy", format!("{}, recovered exactly: {}", percent(e.bit_accuracy), yes_or_no(e.exact))),
        ("evidence", evidence_in_words(e.mode, report.mixing.of > 1 || report.edit.is_some()).to_owned()),
        ("p-value", p),
        ("inverted message", format!("{} of {} match", e.panel.inverted.leak.matches, e.num_bits)),
        ("other keys' messages", other_keys_in_words(&e.panel.other_messages)),
        ("other keys' readings", other_keys_in_words(&e.panel.other_readings)),
    ];
    rows.extend(report.edit.as_ref().map(|undone| ("undone", edit_in_words(undone))));
    rows.extend(report.id.iter().flat_map(id_rows));
    // A single clip has been told of above.
    if report.clips.len() > 1 {
        rows.extend(report.clips.iter().map(|clip| ("clip", clip_in_words(clip, e.num_bits))));
    }
    rows.extend(report.clips.iter().filter_map(cut_row));
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
    rows.push(("receipt", report.commitment.to_string()));
    rows.push((
        "not shown here",
        "that the receipt is older than the clip; a timestamp by someone else can".to_owned(),
    ));
    table(&rows)
}

fn other_keys_in_words(keys: &OtherKeys) -> String {
    let OtherKeys { num_keys, most_matches, as_good, .. } = keys;
    format!("the best of {num_keys} throw-away keys matches {most_matches} bits; {as_good} do as well as the claim")
}

fn id_rows(id: &IdEvidence) -> Vec<Row> {
    let whose = match id.is_promised {
        true => "the one of the receipt".to_owned(),
        false => format!("not {}, the one of the receipt", id.promised),
    };
    let ahead = format!("{:.3} a bit; {} is next, {:.3} behind", id.found.score, id.found.runner_up, id.margin);
    let p = match id.p_value {
        Some(SearchedP { matches, soft_score, searched }) => {
            format!("{soft_score:.2e} at most, as the best of {searched} ({matches:.2e} of the matches)")
        }
        None => "none: the extractor was trained with the message".to_owned(),
    };
    vec![(id_name(id.id_bits), format!("{}, {whose}", id.found.id)), ("id's logits", ahead), ("id's p-value", p)]
}

fn id_name(id_bits: IdBits) -> &'static str {
    match id_bits {
        IdBits::Twelve => "id of 12 bits",
        IdBits::Sixteen => "id of 16 bits",
    }
}

fn clip_in_words(clip: &ClipReading, num_bits: u32) -> String {
    let id = clip.id.map(|id| format!(", id {id}")).unwrap_or_default();
    let ClipReading { name, matches, exact, .. } = clip;
    format!("{name}: {matches} of {num_bits} match, recovered exactly: {}{id}", yes_or_no(*exact))
}

fn edit_in_words(undone: &UndoneEdit) -> String {
    let UndoneEdit { edit: Edit { rotation, crop, right, below, brightness, mirror }, tried } = undone;
    let mut words = Vec::new();
    if *rotation != 0.0 {
        words.push(format!("turned by {rotation} degrees"));
    }
    if *crop != 1.0 {
        words.push(format!("cropped to {crop} of each side"));
    }
    if (*right, *below) != (0.0, 0.0) {
        words
            .push(format!("its middle {right:.3} of the width right of the film's and {below:.3} of the height below"));
    }
    if *brightness != 1.0 {
        words.push(format!("{brightness} times as bright"));
    }
    if *mirror {
        words.push("mirrored".to_owned());
    }
    let words = if words.is_empty() { "nothing".to_owned() } else { words.join(", ") };
    format!("{words}; nearest to the claim of {tried} guesses")
}

fn cut_row(clip: &ClipReading) -> Option<Row> {
    let Rect { x, y, width, height } = clip.cut?;
    Some(("cut to", format!("{width} x {height} px at ({x}, {y}): {}", clip.name)))
}

fn yes_or_no(answer: bool) -> &'static str {
    if answer { "yes" } else { "no" }
}

fn p_in_words(p: &PStatement) -> String {
    match p {
        PStatement::Exact { matches, soft_score } => {
            format!("{soft_score:.2e} exact, of the soft score ({matches:.2e} of the matches)")
        }
        PStatement::Searched(SearchedP { matches, soft_score, searched }) => {
            format!("{soft_score:.2e} at most, of the best of {searched} claims ({matches:.2e} of the matches)")
        }
        PStatement::Empirical { false_positives, num_clips, bound } => {
            format!("none; {false_positives} of {num_clips} unrelated clips read as well, rate at most {bound:.3}")
        }
    }
}
