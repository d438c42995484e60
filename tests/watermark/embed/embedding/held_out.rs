//! What is measured on clips that no step is taken on is what the finished mark is worth.

use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::scene::Camera;
use guard4d_engine::watermark::embed::{ContentChoice, Embedded, Embedding, FramingChoice, HeldOutReport, Start};
use guard4d_engine::watermark::extractor::reader::Reader;

use super::steps::{Shots, config, film, train};
use crate::support::close::assert_close;
use crate::support::gpu::{Gpu, device};
use crate::support::owner::{BITS, Owner};

/// The held-out figures of a finished embedding, by way of frames and the extractor that is delivered.
fn recomputed(gpu: &Gpu, owner: &Owner, embedded: &Embedded, clips: &[Shots]) -> HeldOutReport {
    let bits = BITS as usize;
    let mut reader = Reader::new(gpu, &owner.clip, &owner.key, &embedded.extractor).expect("belongs to the key");
    let (mut marked, mut clean, mut squares, mut values) = (Vec::new(), Vec::new(), 0.0f64, 0.0f64);
    let filmed = film(gpu, owner, embedded, clips);
    for (with, without) in filmed.marked.iter().zip(&filmed.clean) {
        for (a, b) in with.iter().zip(without) {
            let square = |(a, b): (&u8, &u8)| (f64::from(a.abs_diff(*b)) / 255.0).powi(2);
            squares += a.rgb().iter().zip(b.rgb()).map(square).sum::<f64>();
            values += a.rgb().len() as f64;
        }
        marked.extend(reader.logits(with).expect("reads"));
        clean.extend(reader.logits(without).expect("reads"));
    }
    let joint = embedded.extractor.mode == ExtractorMode::Joint;
    let rows = clean.len() / bits;
    let mean = |bit: usize| clean.iter().skip(bit).step_by(bits).sum::<f32>() / rows as f32;
    let zero: Vec<f32> = (0..bits).map(|bit| if joint { mean(bit) } else { 0.0 }).collect();
    let said: Vec<bool> = owner.message.bits().collect();
    let right = (0..marked.len()).filter(|i| (marked[*i] > zero[i % bits]) == said[i % bits]).count();
    let psnr = -10.0 * (squares / values).log10();
    let per_clip = marked.len() / clips.len();
    let frames = (per_clip / bits) as f64;
    let (mut clips_right, mut proven) = (0, 0);
    for clip in marked.chunks_exact(per_clip) {
        let mean = |bit: usize| clip.iter().skip(bit).step_by(bits).map(|v| f64::from(*v)).sum::<f64>() / frames;
        let moved: Vec<f64> = (0..bits).map(|bit| mean(bit) - f64::from(zero[bit])).collect();
        clips_right += (0..bits).filter(|&bit| (moved[bit] > 0.0) == said[bit]).count();
        proven += usize::from(chance_of_as_much(&moved, &said) <= 1e-3);
    }
    HeldOutReport {
        bit_accuracy: right as f32 / marked.len() as f32,
        clip_accuracy: clips_right as f32 / (clips.len() * bits) as f32,
        proven: proven as f32 / clips.len() as f32,
        psnr: psnr as f32,
    }
}

/// Share of all messages that agree with the logits as well as this one, by trying each.
fn chance_of_as_much(logits: &[f64], said: &[bool]) -> f64 {
    let score = |is_one: &dyn Fn(usize) -> bool| -> f64 {
        logits.iter().enumerate().map(|(bit, o)| if is_one(bit) { *o } else { -o }).sum()
    };
    let own = score(&|bit| said[bit]);
    let all = 1usize << logits.len();
    (0..all).filter(|message| score(&|bit| message >> bit & 1 == 1) >= own - 1e-9).count() as f64 / all as f64
}

/// Trains with and without held-out clips.
fn check_held_out(mode: ExtractorMode, content: ContentChoice) {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let off = config(&owner, mode).with(|c| {
        c.optimiser.steps = 3;
        // Held-out clips are read as they are; a reader would find the asset in them, and not quite where it is.
        c.views.framing = FramingChoice::Whole;
        c.extractor.content_mut().into_iter().for_each(|choice| *choice = content);
    });
    let on = off.clone().with(|c| c.optimiser.held_out_every = 2);
    let mut embedding = Embedding::prepare(owner.subject(&gpu), on).expect("prepares");
    let training: Shots = embedding.training_shots().flatten().copied().collect();
    let held_out: Vec<Shots> = embedding.held_out_shots().map(<[_]>::to_vec).collect();
    assert_eq!(training.len(), 2 * held_out[0].len(), "two training clips");
    for (camera, time) in held_out.iter().flatten() {
        let seen = |(c, t): &(Camera, f32)| c.world_to_camera == camera.world_to_camera || t == time;
        assert!(!training.iter().any(seen), "neither a view nor a time of a training clip");
    }
    let before = embedding.held_out().expect("measures").expect("there are clips");
    assert!(before.psnr.is_infinite() && before.psnr > 0.0, "nothing to see yet: {before:?}");
    let (mut reports, embedded) = train(embedding);
    let measured: Vec<_> = reports.iter_mut().map(|r| r.held_out.take()).collect();
    let asked: Vec<_> = measured.iter().map(Option::is_some).collect();
    assert_eq!(asked, [false, true, true], "every second step, and the last");
    let last = measured[2].expect("the last step is measured");
    let want = recomputed(&gpu, &owner, &embedded, &held_out);
    // Sums of f32 against f64: far below a thousandth of a dB.
    assert_close(&[last.psnr], &[want.psnr], 1e-3, 0.0);
    // A logit within rounding of its zero may fall on either side: one of them is allowed to.
    let one = 1.0 / (held_out.iter().map(Vec::len).sum::<usize>() * BITS as usize) as f32;
    assert_close(&[last.bit_accuracy], &[want.bit_accuracy], 1.001 * one, 0.0);
    // And so may one mean of a clip.
    let one = 1.0 / (held_out.len() * BITS as usize) as f32;
    assert_close(&[last.clip_accuracy], &[want.clip_accuracy], 1.001 * one, 0.0);
    // Scores are rounded to a thousandth before they are counted, which moves a p-value by a few messages of 65536.
    assert_eq!(last.proven, want.proven, "clips that prove it");

    assert_eq!(
        embedded.extractor.content.is_some(),
        content == ContentChoice::Foretold,
        "what the extractor foretells"
    );
    // `joint` trains its extractor, and one that is given knows what its own views say instead of foretelling it.
    let is_fitted = mode == ExtractorMode::Joint || content == ContentChoice::Foretold;
    let start = if is_fitted { Start::Fit } else { Start::Frozen(&embedded.extractor) };
    let plain = Embedding::prepare_with(owner.subject(&gpu), off, start).expect("prepares");
    assert_eq!(plain.held_out_shots().count(), 0, "nobody asks");
    let (unmeasured, same) = train(plain);
    assert_eq!(reports, unmeasured, "what the steps see");
    let bits = |e: &Embedded| e.sh_coeffs.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert!(bits(&embedded) == bits(&same), "measuring leaves no trace in the mark");
    assert_eq!(embedded.extractor, same.extractor, "nor in the extractor");
}

#[test]
fn held_out_figures_of_blind_are_those_of_the_finished_mark() {
    check_held_out(ExtractorMode::Blind, ContentChoice::Mean);
}

#[test]
fn held_out_figures_with_foretold_content_are_those_of_the_finished_mark() {
    check_held_out(ExtractorMode::Blind, ContentChoice::Foretold);
}

#[test]
fn held_out_figures_of_joint_are_those_of_the_finished_mark() {
    check_held_out(ExtractorMode::Joint, ContentChoice::Mean);
}
