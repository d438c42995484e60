//! What copies go through on their way to whoever verifies them.

use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::picture::distortion::{Distortion, DistortionKind};
use guard4d_engine::watermark::embed::Profile;

use super::methods::point;
use crate::chart::{Axis, Chart, Series};
use crate::report::Report;
use crate::study::plan::{Arm, COPY_PX, Scale, Take};
use crate::study::summary::{self, Column, Findings};

/// Distortions with their true strengths (see [`DistortionKind`]); the field's names for some of them promise more.
const DISTORTIONS: [(DistortionKind, f64); 19] = [
    (DistortionKind::Identity, 0.0),
    (DistortionKind::Noise, 0.01),
    (DistortionKind::Noise, 0.05),
    (DistortionKind::Rotation, 5.0),
    (DistortionKind::Rotation, 15.0),
    (DistortionKind::Rescale, 0.75),
    (DistortionKind::Rescale, 0.5),
    (DistortionKind::Blur, 0.8),
    (DistortionKind::Blur, 1.5),
    (DistortionKind::Crop, 0.9),
    (DistortionKind::Crop, 0.7),
    (DistortionKind::Crop, 0.4),
    (DistortionKind::Brightness, 0.7),
    (DistortionKind::Brightness, 1.3),
    (DistortionKind::Jpeg, 90.0),
    (DistortionKind::Jpeg, 50.0),
    (DistortionKind::Jpeg, 10.0),
    (DistortionKind::Codec, 1.0),
    (DistortionKind::Codec, 2.0),
];
/// Constant rate factors of H.264.
const RATES: [u8; 4] = [12, 18, 23, 28];

/// What training sees of them in the arms that train on them.
const TRAINED: [&str; 3] = ["rotation:-15..15", "crop:0.7..1", "brightness:0.7..1.3"];

/// Every sound extractor, and the paper's, with and without training on distorted frames.
pub(super) fn arms(scale: &Scale) -> Vec<Arm> {
    let takes: Vec<Take> =
        std::iter::once(Take::Plain)
            .chain(DISTORTIONS.map(|(kind, strength)| {
                Take::Distorted(Distortion::new(kind, strength).expect("strengths of the table"))
            }))
            .chain(RATES.map(Take::H264))
            .collect();
    let modes: &[ExtractorMode] = if scale.quick {
        &[ExtractorMode::Blind]
    } else {
        &[ExtractorMode::None, ExtractorMode::Blind, ExtractorMode::Pretrained, ExtractorMode::Joint]
    };
    let arm = |name: String, mode, distortions: Vec<Distortion>| {
        let config = scale.config(Profile::Balanced, mode).with(|c| c.objective.distortions = distortions);
        Arm { takes: takes.clone(), ..Arm::new(name, config) }
    };
    let both = |&mode: &ExtractorMode| {
        [arm(mode.to_string(), mode, Vec::new()), arm(format!("{mode}, trained on distortions"), mode, trained())]
    };
    modes.iter().flat_map(both).collect()
}

pub(super) fn trained() -> Vec<Distortion> {
    TRAINED.iter().map(|text| text.parse().expect("well written above")).collect()
}

const COLUMNS: [Column; 9] = [
    summary::ARM,
    summary::TAKE,
    summary::ROWS,
    summary::MARKED,
    summary::FRAMES,
    summary::CLEAN,
    summary::P_VALUE,
    summary::PRESENT,
    summary::ERRORS,
];

pub(super) fn report(findings: &Findings) -> Report {
    let groups = findings.groups();
    let (mut takes, mut arms): (Vec<&str>, Vec<&str>) = (Vec::new(), Vec::new());
    for group in &groups {
        for (seen, name) in [(&mut takes, group.take), (&mut arms, group.arm)] {
            if !seen.contains(&name) {
                seen.push(name);
            }
        }
    }
    let place = |take: &str| (0u32..).zip(&takes).find(|(_, t)| **t == take).map(|(i, _)| f64::from(i));
    let series = arms.iter().map(|arm| {
        let of = groups.iter().filter(|g| g.arm == *arm);
        let points = of.filter_map(|g| point(g, place(g.take)?, |r| r.marked, String::new())).collect();
        Series { name: (*arm).to_owned(), points, joined: true }
    });
    Report {
        title: "What copies go through".to_owned(),
        intro: format!(
            "Each mark is embedded once and read from distorted films of {COPY_PX} px a side; all clips of a film \
             together give verdict and p-value. Strengths are the ones really applied: noise by its standard \
             deviation, crop by the share of each side that is left, rotation in degrees, codec a low pass with \
             chroma at half resolution; h264 is x264 through ffmpeg."
        ),
        charts: vec![Chart {
            title: "bits right after distortions".to_owned(),
            series: series.collect(),
            x: Axis::of_names(takes.iter().map(|take| (*take).to_owned()).collect()),
            y: Axis::linear("bits right, %"),
        }],
        tables: vec![summary::table("All scenes", "Means over scenes and seeds.", &COLUMNS, &groups)],
    }
}
