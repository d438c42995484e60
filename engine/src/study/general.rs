//! The general extractor beside the one that is fitted to each asset, at the fidelities that are asked of it, and what it saves.

use super::attacks;
use super::methods::{against_psnr, guard4d, with_bits};
use super::plan::{Arm, DEFAULT_BITS, Scale, Take};
use super::report::Report;
use super::summary::{self, Column, Findings};
use crate::distortion::{Distortion, Kind};
use crate::watermark::embed::{EmbedConfig, Profile};
use crate::watermark::evidence::ExtractorMode;

/// Message lengths, with the fidelities in dB at which 99, 97 and 95 % of the bits are to be read.
const HELD: [(u32, f32); 3] = [(16, 42.0), (32, 40.0), (48, 39.0)];
/// What a mark of 32 bits is to survive with 90 % of them, besides H.264 at [`CRF`].
const COPIES: [(Kind, f64); 6] = [
    (Kind::Rescale, 0.5),
    (Kind::Rotation, 15.0),
    (Kind::Crop, 0.7),
    (Kind::Jpeg, 50.0),
    (Kind::Brightness, 0.7),
    (Kind::Brightness, 1.3),
];
/// Constant rate factor of a usual upload.
const CRF: u8 = 23;
/// Shares of the steps in which the general extractor is to read what the paper's takes all of them for.
const SHARES: [usize; 2] = [4, 10];

/// Both extractors at every length, plainly and on copies, and the seconds of short runs against the paper's.
pub(super) fn arms(scale: &Scale) -> Vec<Arm> {
    let both = || [ExtractorMode::General, ExtractorMode::Blind].into_iter();
    let at = |mode: ExtractorMode, (bits, psnr): (u32, f32), distortions: Vec<Distortion>| {
        let about = if distortions.is_empty() { " of" } else { " trained on distortions," };
        let config = EmbedConfig { distortions, ..scale.config(Profile::Balanced, mode).with_target(psnr) };
        with_bits(Arm::new(format!("{mode}{about} {bits} bits at {psnr} dB"), config), bits)
    };
    let copies = COPIES.map(|(kind, strength)| Distortion::new(kind, strength).expect("strengths of the table"));
    let takes: Vec<Take> = [Take::Plain, Take::H264(CRF)].into_iter().chain(copies.map(Take::Distorted)).collect();
    let plain = HELD.into_iter().flat_map(|held| both().map(move |mode| (mode, held)));
    let plain = plain.map(|(mode, held)| at(mode, held, Vec::new()));
    let copied = both().map(|mode| Arm { takes: takes.clone(), ..at(mode, HELD[1], attacks::trained()) });
    let usual = scale.config(Profile::Balanced, ExtractorMode::General);
    let short = SHARES.map(|share| {
        let config = EmbedConfig { steps: (usual.steps / share).max(1), ..usual.clone() };
        Arm::new(format!("general, steps x1/{share}"), config)
    });
    let whole = [Arm::new("general", usual.clone()), guard4d(scale, DEFAULT_BITS)];
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
        title: "The general extractor".to_owned(),
        intro: "One extractor for all assets, made from random scenes before any of them was there, beside one that is fitted \
                to each (blind), and the paper's, which is trained with each message. Of the asset itself the general one \
                takes its unmarked colours and the mean of its unmarked features."
            .to_owned(),
        charts: vec![against_psnr("bits right against PSNR", findings)],
        tables: vec![summary::table("All scenes", "Means over scenes and seeds.", &COLUMNS, &findings.groups())],
    }
}
