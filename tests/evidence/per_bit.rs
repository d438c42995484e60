//! What clips without the mark say, bit by bit.

use guard4d_engine::evidence::control::ControlState;
use guard4d_engine::evidence::message::Message;
use guard4d_engine::evidence::per_bit::PerBit;
use guard4d_engine::evidence::reading::Reading;
use guard4d_engine::release::evaluate::chance_deviation;

use crate::support::owner::BITS;

fn reading(message: Message) -> Reading {
    let logits: Vec<f32> = message.bits().map(|bit| if bit { 1.0 } else { -1.0 }).collect();
    Reading::from_logits(&logits, message.num_bits()).expect("finite")
}

#[test]
fn a_fixed_word_hides_among_all_bits_and_shows_bit_by_bit() {
    let message = Message::from_value(0xb0, BITS).expect("eight bits");
    // Half of the bits are right, always the same ones.
    let word = reading(Message::from_value(0xbf, BITS).expect("eight bits"));
    let all = chance_deviation(&vec![word.clone(); 20], &message).expect("equal lengths");
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
