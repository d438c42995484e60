//! Bits, payloads and their limits.

use guard4d_engine::base::prf::{MasterSecret, Prf, Purpose};
use guard4d_engine::evidence::message::Message;
use guard4d_engine::evidence::payload::Payload;
use proptest::prelude::*;

fn prf(seed: u8) -> Prf {
    Prf::new(&MasterSecret::from_bytes([seed; 32]))
}

fn refused(text: &str, num_bits: u32) -> String {
    let error = Payload::parse(text, num_bits).expect_err("this is refused");
    assert_eq!(error.exit_code(), 2, "{text}");
    error.to_string()
}

#[test]
fn payloads_are_read_first_bit_first() {
    let from_hex = Payload::parse("hex:b001", 16).expect("four digits");
    let from_bits = Payload::parse("bits:1011000000000001", 16).expect("sixteen digits");
    assert_eq!(from_hex, from_bits);
    let Payload::Chosen(message) = from_hex else { panic!("hex: is a chosen payload") };
    let bits: Vec<bool> = message.bits().collect();
    assert_eq!(bits[..4], [true, false, true, true]);
    assert!(bits[15], "the last bit is the least significant");
    assert_eq!(message.value(), 0xb001);
    assert_eq!(Payload::parse("random", 48).expect("a word"), Payload::Random(48));
    assert_eq!(Payload::parse("hex:3ff", 10).expect("ten bits"), Payload::parse("bits:1111111111", 10).expect("ten"));
}

#[test]
fn refusals_name_the_limits() {
    assert!(refused("hex:12345", 16).contains("4 hexadecimal digits"));
    assert!(refused("hex:123", 16).contains("4 hexadecimal digits"), "short payloads are not padded");
    assert!(refused("hex:12345", 16).contains("1 to 128 bits"));
    assert!(refused("hex:12g4", 16).contains("hexadecimal"));
    assert!(refused("hex:+123", 16).contains("hexadecimal"), "signs are not digits");
    assert!(refused("bits:0102", 4).contains("digits 0 or 1"));
    assert!(refused("hex:400", 10).contains("11 bits"), "the unused high digits must be 0");
    assert!(refused("cafe", 16).contains("random"));
    assert!(refused("", 16).contains("random"));
    refused("hex:", 16);
    assert!(refused("id:12:4096", 32).contains("0 to 4095"));
    assert!(refused("id:16:1", 16).contains("multiple of 8, 24 to 128 bits"), "no bit to spare");
    assert!(refused("id:12:1", 8).contains("16 to 128 bits"), "too short");
    for text in ["id:12:", "id:12", "id:", "id:13:1", "id:12:+1", "id:12:0x1", "id:12:99999999999", "id:12:1:2"] {
        assert!(refused(text, 32).contains("id:16:N"), "{text}");
    }
    refused("random", 0);
    refused("random", 129);
    refused(&"é".repeat(5000), 16);
    assert!(Message::from_bits(&[]).is_err() && Message::from_bits(&[true; 129]).is_err(), "lengths");
    assert!(Message::from_bits(&[true; 128]).is_ok(), "128 bits");
}

#[test]
fn half_of_the_bits_flip_and_each_as_often() {
    const DRAWS: u32 = 2000;
    let mut rng = prf(5).stream(Purpose::SwapMessage, 0);
    for num_bits in 1..=128 {
        let message = Message::random(num_bits, &mut rng).expect("a length");
        let other = message.half_flipped(&mut rng);
        assert_eq!(message.hamming(&other).expect("equal lengths"), num_bits / 2, "{num_bits} bits");
    }
    let message = Message::from_value(0, 16).expect("sixteen bits");
    let mut flips = [0_u32; 16];
    for _ in 0..DRAWS {
        for (count, bit) in flips.iter_mut().zip(message.half_flipped(&mut rng).bits()) {
            *count += u32::from(bit);
        }
    }
    // Five standard deviations of a fair coin's count.
    let spread = 5.0 * f64::from(DRAWS).sqrt() / 2.0;
    let fair = flips.iter().all(|&n| (f64::from(n) - f64::from(DRAWS) / 2.0).abs() < spread);
    assert!(fair, "{flips:?}");
}

#[test]
fn distance_and_inversion() {
    let message = Message::from_value(0b1011, 4).expect("four bits");
    assert_eq!(message.inverted().value(), 0b0100);
    assert_eq!(message.hamming(&message.inverted()).expect("equal lengths"), 4);
    let near = Message::from_value(0b1010, 4).expect("four bits");
    assert!((message.bit_accuracy(&near).expect("equal lengths") - 0.75).abs() < 1e-15, "one rounding");
    let longer = Message::from_value(0b1011, 5).expect("five bits");
    assert!(message.hamming(&longer).is_err(), "lengths differ");
    assert_ne!(message, longer);
}

#[test]
fn a_chosen_payload_is_hidden_by_the_pad_and_comes_back() {
    let payload = Payload::parse("hex:00000000", 32).expect("eight digits");
    let message = payload.message(&prf(1)).expect("32 bits");
    assert_ne!(message.value(), 0, "zeros would not be a uniform message");
    assert_ne!(message, payload.message(&prf(2)).expect("32 bits"));
    assert_eq!(Payload::from_message(&message, &prf(1)).expect("32 bits"), payload);
    let own = Payload::Random(32).message(&prf(1)).expect("32 bits");
    assert_eq!(own, Payload::Random(32).message(&prf(1)).expect("32 bits"));
    assert_ne!(own, message);
}

#[test]
fn commitments_differ_by_key_length_and_value() {
    let message = Message::from_value(5, 16).expect("16 bits");
    let mac = message.commitment(&prf(1));
    assert_eq!(mac, message.commitment(&prf(1)));
    assert_ne!(mac, message.commitment(&prf(2)));
    assert_ne!(mac, Message::from_value(5, 17).expect("17 bits").commitment(&prf(1)));
    assert_ne!(mac, Message::from_value(4, 16).expect("16 bits").commitment(&prf(1)));
}

proptest! {
    #[test]
    fn display_parses_back(value: u128, num_bits in 1_u32..=128) {
        let message = Message::from_value(value >> (128 - num_bits), num_bits).expect("it fits");
        let back = Payload::parse(&message.to_string(), num_bits).expect("our own form");
        prop_assert_eq!(back, Payload::Chosen(message));
        let bits: Vec<bool> = message.bits().collect();
        prop_assert_eq!(Message::from_bits(&bits).expect("same length"), message);
        prop_assert_eq!(message.inverted().inverted(), message);
    }

    #[test]
    fn no_text_panics(text in ".{0,40}", num_bits: u32) {
        let _any = Payload::parse(&text, num_bits);
        let _any = Payload::parse(&format!("hex:{text}"), num_bits);
        let _any = Payload::parse(&format!("id:12:{text}"), num_bits);
    }
}

/// Every bit of random messages is 1 half of the time.
#[test]
fn random_messages_are_balanced() {
    let rng = &mut prf(9).stream(Purpose::OtherKeys, 0);
    let mut ones = [0_u32; 128];
    for _ in 0..4000 {
        for (count, bit) in ones.iter_mut().zip(Message::random(128, rng).expect("128 bits").bits()) {
            *count += u32::from(bit);
        }
    }
    // Standard deviation sqrt(4000)/2 = 31.6; five of them, 128 bits, fixed seed.
    assert!(ones.iter().all(|count| count.abs_diff(2000) < 158), "{ones:?}");
}
