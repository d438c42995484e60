//! `guard4d lab pretrain`: what it writes, and that an embedding goes through it.

use std::fs;

use guard4d_engine::watermark::extractor::pretrained::PretrainedExtractor;

use super::{guard4d, names, put, scratch};
use crate::support::gpu::device;

const SMALL: [&str; 8] = ["--bits", "8", "--train-clips", "2", "--responses", "8", "--size", "32"];

#[test]
fn an_extractor_and_its_curve_are_written() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let out = folder.path().join("pretrained.safetensors");
    let pretrain = |scenes: &str, more: &[&str]| {
        let mut args: Vec<&dyn AsRef<std::ffi::OsStr>> =
            vec![&"lab", &"pretrain", &"--scenes", &scenes, &"--out", &out];
        args.extend(SMALL.iter().chain(more).map(|arg| arg as &dyn AsRef<std::ffi::OsStr>));
        guard4d(&args)
    };
    pretrain("procedural:2", &[]).done();
    assert_eq!(names(folder.path()), ["pretrained.csv", "pretrained.safetensors"], "no checkpoint is left");
    let curve = fs::read_to_string(folder.path().join("pretrained.csv")).expect("a curve");
    let lines: Vec<&str> = curve.lines().collect();
    assert_eq!(lines[0], "scenes,scene,seconds,separation");
    assert!(lines.len() == 3 && lines[2].starts_with("2,procedural:1,"), "{curve}");
    let pretrained = PretrainedExtractor::read(&out).expect("just written");
    let command =
        "guard4d lab pretrain --scenes procedural:2 --bits 8 --seed 0 --train-clips 2 --responses 8 --size 32";
    assert_eq!((pretrained.most_bits, pretrained.made_by.as_str()), (8, command));
    pretrain("procedural:2", &[]).refused(73, &["pretrained.safetensors"]);
    pretrain("procedural:none", &["-w"]).refused(2, &["procedural:N"]);
    let gone = folder.path().join("gone");
    pretrain(&gone.display().to_string(), &["-w"]).refused(66, &["gone"]);
    pretrain("procedural:2", &["-w", "--resume"]).refused(66, &["pretrained.safetensors.checkpoint"]);
    assert_eq!(PretrainedExtractor::read(&out).expect("still there"), pretrained, "a refusal loses nothing");
    put(folder.path(), "pretrained.safetensors.checkpoint.safetensors", b"not one");
    pretrain("procedural:2", &["-w", "--resume"]).refused(65, &["pretrained.safetensors.checkpoint"]);
}
