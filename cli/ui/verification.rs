//! A verification's report, for people.

use guard4d_engine::detect::compared_message::ComparedMessage;
use guard4d_engine::detect::free_part::{Checked, FreePart};
use guard4d_engine::detect::gathered::SharedClaim;
use guard4d_engine::detect::owner_chips::ChipsReading;
use guard4d_engine::detect::report::{Choices, ClipReading, IdEvidence, Undone, VerifyReport};
use guard4d_engine::evidence::id_code::{IdBits, SearchedP};
use guard4d_engine::evidence::judgement::PStatement;
use guard4d_engine::evidence::negative_controls::PooledResult;
use guard4d_engine::evidence::other_keys::OtherKeysResult;
use guard4d_engine::locate::finding::LocateReport;
use guard4d_engine::media::framing::Rect;
use guard4d_engine::picture::part::Framings;
use guard4d_engine::picture::undo_guess::UndoGuess;

use super::dates::{date_in_words, not_shown, root_in_words};
use super::report::{Row, evidence_in_words, percent, power, table};

/// All of it as a table.
pub(crate) fn human(report: &VerifyReport) -> String {
    let e = &report.evidence;
    let p = p_in_words(&e.p_value);
    let mut rows = vec![
        ("verdict", format!("{:?}", report.verdict).to_uppercase()),
        ("dated", date_in_words(&report.standing)),
        ("bits", format!("{} of {} match ({} frames)", e.matches, e.num_bits, report.frames)),
        ("bit accuracy", format!("{}, recovered exactly: {}", percent(e.bit_accuracy), yes_or_no(e.exact))),
        ("evidence", evidence_in_words(e.mode, is_chosen(report)).to_owned()),
        ("p-value", p),
    ];
    rows.extend(report.compared_message.as_ref().map(|said| ("beside the original", compared_in_words(said))));
    rows.extend(report.owner_chips.as_ref().map(|chips| ("owner's chips", chips_in_words(chips))));
    rows.extend(report.located.iter().map(|found| ("cameras found", found_in_words(found))));
    rows.extend(e.panel.pools.iter().map(|pool| ("control", pool_in_words(pool))));
    rows.extend([
        ("arithmetic: inverted", format!("{} of {} match", e.panel.inverted.chance_deviation.matches, e.num_bits)),
        ("arithmetic: other messages", other_keys_in_words(&e.panel.other_messages)),
        ("arithmetic: other readings", other_keys_in_words(&e.panel.other_readings)),
    ]);
    rows.extend(report.undone.as_ref().map(|undone| ("undone", undone_in_words(undone))));
    rows.extend(report.id.iter().flat_map(id_rows));
    // A single clip has been told of above.
    if report.clips.len() > 1 {
        rows.extend(report.clips.iter().map(|clip| ("clip", clip_in_words(clip, e.num_bits))));
    }
    rows.extend(report.clips.iter().filter_map(cut_row));
    rows.extend(report.clips.iter().filter_map(framed_row));
    for control in &e.panel.supplied {
        rows.push((
            "control",
            format!(
                "{}: {} of {} match",
                control.name, control.chance_deviation.matches, control.chance_deviation.num_bits
            ),
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
    rows.push(choices_row(&report.choices));
    rows.push(("the extractor's free part", free_part_in_words(&report.free_part)));
    rows.push(("receipt", report.commitment.to_string()));
    rows.extend(report.standing.root.as_ref().map(|root| ("root", root_in_words(root))));
    rows.push(("not shown here", not_shown(&report.standing).to_owned()));
    table(&rows)
}

/// In how much of a film the original was found.
pub(super) fn found_in_words(found: &LocateReport) -> String {
    let likeness =
        found.likeness.map_or_else(String::new, |likeness| format!(", {likeness:.2} of 1 like the original"));
    format!("{} of {} frames{likeness}", found.located, found.looked_at)
}

/// What the message says where film and original are compared.
pub(super) fn compared_in_words(said: &ComparedMessage) -> String {
    let ComparedMessage { matches, num_bits, frames, id, p_value, proves } = said;
    let p = p_in_words(&PStatement::Searched(*p_value));
    let id = id.map_or_else(String::new, |id| format!(", id {id}"));
    let says = if *proves { "that proves it alone" } else { "that proves nothing alone" };
    format!("{matches} of {num_bits} bits match{id} ({frames} frames), p {p}: {says}")
}

/// What the owner's chips say.
pub(super) fn chips_in_words(chips: &ChipsReading) -> String {
    let ChipsReading { claim: SharedClaim { score, .. }, frames, searched, proves } = chips;
    let p = power(chips.log10_p_searched().min(0.0));
    let says = if *proves { "they prove it alone" } else { "they prove nothing alone" };
    format!("p <= {p}, {score:.1} deviations above chance ({frames} frames, times {searched}): {says}")
}

pub(super) fn pool_in_words(result: &PooledResult) -> String {
    let PooledResult { pool, num_readings, matches, num_bits, p_value, .. } = result;
    format!("{pool} ({num_readings}): {matches} of {num_bits} bits match, p = {p_value:.2}")
}

pub(super) fn free_part_in_words(part: &FreePart) -> String {
    let numbers = part.numbers;
    match part.checked {
        Checked::Refitted { .. } => format!("{numbers} numbers; fitted to the original again, and the same"),
        Checked::NotChecked => format!(
            "not checked: whoever sealed the receipt could have chosen {numbers} numbers; --original fits them again"
        ),
        Checked::Trained => format!("{numbers} numbers and a network, trained with the message"),
    }
}

/// What was chosen by hand.
pub(super) fn choices_row(choices: &Choices) -> Row {
    let Choices {
        claims,
        films,
        models,
        known_cameras,
        vouches_for_clip,
        gives_directions,
        start,
        every,
        max_frames,
        crop,
        picture_size_px,
    } = choices;
    let mut words = Vec::new();
    if *films > 1 {
        words.push(format!("{films} films, read as one"));
    }
    if *models > 0 {
        words.push("the cameras that film a model".to_owned());
    }
    if *known_cameras > 0 {
        words.push("the cameras that frames are cut by".to_owned());
    }
    if *vouches_for_clip {
        words.push("the CLIP checkpoint, by its hash".to_owned());
    }
    if *gives_directions {
        words.push("the directions of the pretrained extractor".to_owned());
    }
    if *start > 0 || *every > 1 {
        words.push(format!("one of {every} frames from frame {start} on"));
    }
    words.extend(max_frames.map(|most| format!("at most {most} frames of each film")));
    words.extend(crop.map(|Rect { x, y, width, height }| format!("the part of {width} x {height} px at ({x}, {y})")));
    words.extend(picture_size_px.map(|(width, height)| format!("pictures brought to {width} x {height} px")));
    let counted = match claims {
        1 => "counted as the only claim; --claims counts others that were tried".to_owned(),
        some => format!("counted as one of {some} claims"),
    };
    words.push(counted);
    ("chosen by hand", words.join("; "))
}

/// Whether the claim was chosen from several that could have been made.
pub(super) fn is_chosen(report: &VerifyReport) -> bool {
    report.key_rotation.of > 1 || report.undone.is_some() || report.standing.receipts() > 1 || report.choices.claims > 1
}

pub(super) fn other_keys_in_words(keys: &OtherKeysResult) -> String {
    let OtherKeysResult { num_keys, most_matches, as_good, .. } = keys;
    format!("the best of {num_keys} other keys matches {most_matches} bits; {as_good} do as well as the claim")
}

pub(super) fn id_rows(id: &IdEvidence) -> Vec<Row> {
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

pub(super) fn undone_in_words(undone: &Undone) -> String {
    let Undone { guess: UndoGuess { rotation, crop, right, below, brightness, mirror }, tried } = undone;
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

/// How a film was framed, unless it was in no special way.
pub(super) fn framed_row(clip: &ClipReading) -> Option<Row> {
    let Framings { cut, turned, usual, not_found } = &clip.framings;
    if *cut == 0 && not_found.is_empty() {
        return None;
    }
    let mut words = Vec::new();
    words.extend((*cut > 0).then(|| format!("{cut} frames as training was")));
    words.extend((*turned > 0).then(|| format!("{turned} of them turned upright")));
    words.extend((*usual > 0).then(|| format!("{usual} frames as they are, which is as training was")));
    words.extend(not_found.iter().map(|(why, frames)| format!("{frames} frames shown whole: {why}")));
    Some(("framed", format!("{}: {}", words.join("; "), clip.name)))
}

fn yes_or_no(answer: bool) -> &'static str {
    if answer { "yes" } else { "no" }
}

pub(super) fn p_in_words(p: &PStatement) -> String {
    match p {
        PStatement::Exact { matches, soft_score } => {
            format!("{soft_score:.2e} exact, of the soft score ({matches:.2e} of the matches)")
        }
        PStatement::NotCommitted(SearchedP { matches, soft_score, .. }) => {
            format!("none: not committed (were it, {soft_score:.2e} of the soft score, {matches:.2e} of the matches)")
        }
        PStatement::Searched(SearchedP { matches, soft_score, searched }) => {
            format!("{soft_score:.2e} at most, of the best of {searched} claims ({matches:.2e} of the matches)")
        }
        PStatement::Empirical { false_positives, num_clips, bound } => {
            format!("none; {false_positives} of {num_clips} unrelated clips read as well, rate at most {bound:.3}")
        }
    }
}
