//! Where the message lives, in the asset or in the extractor, by extractor and control loss.

use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::watermark::embed::{Control, Profile};

use super::ablation::UNTRAINED;
use super::methods::point;
use crate::chart::{Axis, Chart, Series};
use crate::report::Report;
use crate::study::plan::{Arm, Scale, Take};
use crate::study::summary::{self, Column, Findings};

/// Strengths at which a finished mark is read again, beside its own.
const STRENGTHS: [f32; 7] = [0.0, 0.25, 0.5, 0.75, 1.25, 1.5, 2.0];
/// Those of a first look.
const QUICK_STRENGTHS: [f32; 2] = [0.0, 0.5];
/// ε of the paper's control loss, from what makes it explode to what makes it gentle.
const EPSILONS: [f32; 6] = [1e-6, 1e-3, 1e-2, 0.1, 0.5, 1.0];

/// Every extractor with a strength sweep and a message swap, and `joint` with every control loss.
pub(super) fn arms(scale: &Scale) -> Vec<Arm> {
    let strengths: &[f32] = if scale.quick { &QUICK_STRENGTHS } else { &STRENGTHS };
    let takes: Vec<Take> = std::iter::once(Take::Plain).chain(strengths.iter().map(|k| Take::Strength(*k))).collect();
    let arm = |mode| Arm {
        takes: takes.clone(),
        is_contested: true,
        ..Arm::new(format!("{mode}"), scale.config(Profile::Balanced, mode))
    };
    let mut arms = ExtractorMode::ALL.map(arm).to_vec();
    if !scale.quick {
        let losses = EPSILONS.map(|eps| (format!("joint, inverse-bce {eps}"), Control::InverseBce { eps }));
        let bounded = [("joint, hinge 0.5", Control::Hinge { eps: 0.5 }), ("joint, chance", Control::Chance)];
        let bounded = bounded.map(|(name, control)| (name.to_owned(), control));
        arms.extend(losses.into_iter().chain(bounded).map(|(name, control)| {
            let config = scale.config(Profile::Balanced, ExtractorMode::Joint);
            Arm::new(name, config.with(|c| c.extractor.joint_mut().into_iter().for_each(|j| j.control = control)))
        }));
    }
    arms
}

const ACCURACY: [Column; 12] = [
    summary::ARM,
    summary::ROWS,
    summary::MARKED,
    summary::FRAMES,
    summary::CLEAN,
    ("bit on which clean clips agree most: bias", |g| g.decimals(|r| r.clean_bit_bias, 2)),
    summary::NOISY,
    summary::OTHERS,
    summary::PSNR,
    summary::P_VALUE,
    summary::PRESENT,
    summary::ERRORS,
];

const PLACE: [Column; 9] = [
    summary::ARM,
    summary::MARKED,
    UNTRAINED,
    ("swap: second message, %", |g| g.percent_range(|r| r.swap_second)),
    ("swap: first message, %", |g| g.percent_range(|r| r.swap_first)),
    ("another key's own message, %", |g| g.percent_range(|r| r.wrong_key_own)),
    ("another owner's copy, %", |g| g.control(|r| r.other_owner, |r| r.other_owner_in_band)),
    ("forged afterwards, %", |g| g.percent_range(|r| r.forged)),
    ("verdict on the forgery", |g| g.verdicts(|r| &r.forged_verdict)),
];

const SWEEP: [Column; 5] = [summary::ARM, summary::TAKE, summary::MARKED, summary::PSNR, summary::PRESENT];

pub(super) fn report(findings: &Findings) -> Report {
    let groups = findings.groups();
    let sweep = ExtractorMode::ALL.map(|mode| {
        let mode = mode.to_string();
        let of = groups.iter().filter(|g| g.arm == mode);
        let mut points: Vec<_> = of.filter_map(|g| point(g, strength(g.take)?, |r| r.marked, String::new())).collect();
        points.sort_by(|a, b| a.x.total_cmp(&b.x));
        Series { name: mode, points, joined: true }
    });
    let plain = findings.groups_where(|row| row.take == Take::Plain.to_string());
    Report {
        title: "Extractors, and where the message lives".to_owned(),
        intro: "Four extractors with one fidelity: none (CLIP and decoder alone), blind (a front end that never saw \
                a message), pretrained (one front end for all assets) and joint (the paper's, trained with the \
                message); then joint with the paper's control loss at several ε and with bounded ones. An asset that \
                carries its message gives it to R as it was before its training, and a second copy optimised through \
                the frozen extractor gives the second message; an extractor that holds the message says the first \
                one to all of them."
            .to_owned(),
        charts: vec![Chart {
            title: "a finished mark made weaker or stronger".to_owned(),
            x: Axis::linear("factor on the offsets"),
            y: Axis::linear("bits right, %"),
            series: sweep.to_vec(),
        }],
        tables: vec![
            summary::table("Accuracy and controls", "", &ACCURACY, &plain),
            summary::table(
                "Where the message lives",
                "Swap: both messages share half of their bits, so that whoever holds one reads the other at 50 %. \
                 Forged: an accuser trains R afterwards until unmarked clips say the message; what verify would say \
                 of these clips then.",
                &PLACE,
                &plain,
            ),
            summary::table("Strength", "The extractor was fitted to strength 1.", &SWEEP, &groups),
        ],
    }
}

/// The strength that a film was made at.
fn strength(take: &str) -> Option<f64> {
    if take == Take::Plain.to_string() { Some(1.0) } else { take.strip_prefix("strength ")?.parse().ok() }
}
