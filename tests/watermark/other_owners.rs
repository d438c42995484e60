//! What clips without the mark say, bit by bit, and what copies of other owners say.

use guard4d_engine::watermark::cross_examination::{
    OtherOwner, OtherScene, Witnesses, cross_examine, read_other_owners,
};
use guard4d_engine::watermark::embed::{Embedded, Embedding, Subject};
use guard4d_engine::watermark::evaluate::{HeldOut, leak};
use guard4d_engine::watermark::key::Key;
use guard4d_engine::watermark::message::Message;
use guard4d_engine::watermark::null_panel::ControlState;
use guard4d_engine::watermark::per_bit::PerBit;
use guard4d_engine::watermark::reading::Reading;

use crate::support::gpu::{Gpu, device};
use crate::support::owner::{BITS, Owner, cameras, key_file_of};

fn reading(message: Message) -> Reading {
    let logits: Vec<f32> = message.bits().map(|bit| if bit { 1.0 } else { -1.0 }).collect();
    Reading::from_logits(&logits, message.num_bits()).expect("finite")
}

#[test]
fn a_fixed_word_hides_among_all_bits_and_shows_bit_by_bit() {
    let message = Message::from_value(0xb0, BITS).expect("eight bits");
    // Half of the bits are right, always the same ones.
    let word = reading(Message::from_value(0xbf, BITS).expect("eight bits"));
    let all = leak(&vec![word.clone(); 20], &message).expect("equal lengths");
    assert_eq!((all.share(), all.state), (0.5, ControlState::Quiet), "taken together nothing shows");
    let bits = PerBit::of(&vec![word.clone(); 20], &message).expect("equal lengths");
    assert_eq!((bits.clips, bits.constant, bits.max_deviation), (20, BITS, 0.5));
    assert_eq!(bits.agreeing, [[20; 4], [0; 4]].concat(), "most significant bit first");
    assert_eq!(bits.state, ControlState::Fires);
    // 8 coins of 2^-19 each.
    assert_eq!(bits.constant_by_chance, 8.0 / f64::from(1 << 19));
    // One clip has nothing but constant bits, and says nothing.
    let one = PerBit::of(&[word], &message).expect("equal lengths");
    assert_eq!((one.constant, one.constant_by_chance, one.state), (BITS, 8.0, ControlState::Quiet));
}

#[test]
fn bits_that_fall_both_ways_are_quiet() {
    let message = Message::from_value(0xb0, BITS).expect("eight bits");
    // Bit j of the numbers 0 to 255 is set in every other run of 2^j of them.
    let readings: Vec<_> = (0..=255).map(|n| reading(Message::from_value(n, BITS).expect("eight bits"))).collect();
    let bits = PerBit::of(&readings, &message).expect("equal lengths");
    assert_eq!((bits.agreeing.as_slice(), bits.max_deviation), ([128; 8].as_slice(), 0.0));
    assert_eq!((bits.constant, bits.state), (0, ControlState::Quiet));
    assert!(bits.band_low < 128 && bits.band_high == 256 - bits.band_low, "{bits:?}");
    PerBit::of(&[], &message).expect_err("nothing was read");
    let longer = Message::from_value(0, 16).expect("sixteen bits");
    PerBit::of(&readings, &longer).expect_err("other lengths");
}

fn mark(gpu: &Gpu, owner: &Owner, subject: Subject<'_>) -> (Embedded, HeldOut) {
    let mut embedding = Embedding::prepare(subject, owner.config.clone()).expect("prepares");
    while embedding.step().expect("steps").is_some() {}
    let embedded = embedding.finish().expect("finishes");
    let film = HeldOut::shoot(gpu, &owner.model, &embedded.sh_coeffs, &cameras()).expect("films");
    (embedded, film)
}

#[test]
fn copies_of_other_owners_are_read_one_by_one_and_together() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let subject = owner.subject(&gpu);
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("other.key");
    let file = key_file_of(&owner.clip, [9; 32], 12);
    std::fs::write(&path, file.to_bytes().expect("serialises")).expect("writable");
    let other_key = Key::read(&path, &owner.clip).expect("the key fits the checkpoint");
    let other_message = other_key.own_message();
    let other = Subject { key: &other_key, message: &other_message, ..subject };
    let (own, theirs) = (mark(&gpu, &owner, subject), mark(&gpu, &owner, other));
    assert!(own.0.sh_coeffs != theirs.0.sh_coeffs, "two owners, two marks");

    let extractor = &own.0.extractor;
    let owners = [
        OtherOwner { name: "second", clips: &theirs.1.marked },
        OtherOwner { name: "absent", clips: &[] },
        OtherOwner { name: "ourselves", clips: &own.1.marked },
    ];
    let said = read_other_owners(&subject, extractor, &owners).expect("reads").expect("there are two");
    let names: Vec<_> = said.owners.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["second", "ourselves"], "who has a clip");
    let sum: u32 = said.owners.iter().map(|(_, leak)| leak.matches).sum();
    assert_eq!((said.all.matches, said.all.num_bits), (sum, 2 * BITS));
    assert_eq!(said.bits.agreeing.iter().sum::<u32>(), sum, "the same bits, counted by column");
    // The owner's own copy reads as in an evaluation.
    let evaluation = own.1.evaluate(&gpu, &owner.clip, &owner.key, extractor, &owner.message).expect("reads");
    assert_eq!(vec![said.owners[1].1.matches], evaluation.matches);
    assert_eq!(evaluation.clean_bits.agreeing.iter().sum::<u32>(), evaluation.clean_leak.matches);
    assert_eq!(evaluation.noisy_bits.agreeing.iter().sum::<u32>(), evaluation.noisy_leak.matches);
    assert!(read_other_owners(&subject, extractor, &owners[1..2]).expect("reads").is_none(), "nobody");

    let scenes = [OtherScene { name: "other", clips: &own.1.clean }];
    let witnesses = Witnesses { scenes: &scenes, stranger: &other_key, untrained: None };
    let examined = cross_examine(&subject, extractor, &own.1, &witnesses).expect("reads");
    assert_eq!(examined.other_scenes_bits, Some(evaluation.clean_bits), "the other scene is the clean one");
}
