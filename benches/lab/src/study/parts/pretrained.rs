//! The pretrained extractor beside the one that is fitted to each asset, at the fidelities that are asked of it, and
//! what it saves.

use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::picture::distortion::{Distortion, DistortionKind};
use guard4d_engine::watermark::embed::Profile;

use super::attacks;
use super::methods::{against_psnr, guard4d, with_bits};
use crate::report::Report;
use crate::study::plan::{Arm, DEFAULT_BITS, Scale, Take};
use crate::study::summary::{self, Column, Findings};

/// Message lengths, with the fidelities in dB at which 99, 97 and 95 % of the bits are to be read.
const HELD: [(u32, f32); 3] = [(16, 42.0), (32, 40.0), (48, 39.0)];
/// What a mark of 32 bits is to survive with 90 % of them, besides H.264 at [`CRF`].
const COPIES: [(DistortionKind, f64); 6] = [
    (DistortionKind::Rescale, 0.5),
    (DistortionKind::Rotation, 15.0),
    (DistortionKind::Crop, 0.7),
    (DistortionKind::Jpeg, 50.0),
    (DistortionKind::Brightness, 0.7),
    (DistortionKind::Brightness, 1.3),
];
/// Constant rate factor of a usual upload.
const CRF: u8 = 23;
/// Shares of the steps in which the pretrained extractor is to read what the paper's takes all of them for.
const SHARES: [usize; 2] = [4, 10];

/// Both extractors at every length, plainly and on copies, and the seconds of short runs against the paper's.
pub(super) fn arms(scale: &Scale) -> Vec<Arm> {
    let both = || [ExtractorMode::Pretrained, ExtractorMode::Blind].into_iter();
    let at = |mode: ExtractorMode, (bits, psnr): (u32, f32), distortions: Vec<Distortion>| {
        let about = if distortions.is_empty() { " of" } else { " trained on distortions," };
        let config =
            scale.config(Profile::Balanced, mode).with_target(psnr).with(|c| c.objective.distortions = distortions);
        with_bits(Arm::new(format!("{mode}{about} {bits} bits at {psnr} dB"), config), bits)
    };
    let copies = COPIES.map(|(kind, strength)| Distortion::new(kind, strength).expect("strengths of the table"));
    let takes: Vec<Take> = [Take::Plain, Take::H264(CRF)].into_iter().chain(copies.map(Take::Distorted)).collect();
    let plain = HELD.into_iter().flat_map(|held| both().map(move |mode| (mode, held)));
    let plain = plain.map(|(mode, held)| at(mode, held, Vec::new()));
    let copied = both().map(|mode| Arm { takes: takes.clone(), ..at(mode, HELD[1], attacks::trained()) });
    let usual = scale.config(Profile::Balanced, ExtractorMode::Pretrained);
    let short = SHARES.map(|share| {
        let config = usual.clone().with(|c| c.optimiser.steps = (usual.optimiser.steps / share).max(1));
        Arm::new(format!("pretrained, steps x1/{share}"), config)
    });
    let whole = [Arm::new("pretrained", usual.clone()), guard4d(scale, DEFAULT_BITS)];
    plain.chain(copied).chain(short).chain(whole).collect()
}

const COLUMNS: [Column; 11] = [
    summary::ARM,
    summary::TAKE,
    summary::ROWS,
    summary::MARKED,
    summary::FRAMES,
    summary::CLEAN,
    summary::PSNR,
    summary::OBJECT,
    summary::P_VALUE,
    summary::PRESENT,
    summary::CPU_SECONDS,
];

pub(super) fn report(findings: &Findings) -> Report {
    Report {
        title: "The pretrained extractor".to_owned(),
        intro: "One extractor for all assets, made from random scenes before any of them was there, beside one that \
                is fitted to each (blind), and the paper's, which is trained with each message. Of the asset itself \
                the pretrained one takes its unmarked colours and the mean of its unmarked features."
            .to_owned(),
        charts: vec![against_psnr("bits right against PSNR", findings)],
        tables: vec![summary::table("All scenes", "Means over scenes and seeds.", &COLUMNS, &findings.groups())],
    }
}
