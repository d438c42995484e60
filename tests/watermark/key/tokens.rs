//! Bit-to-token tables.

use std::collections::HashSet;

use guard4d_engine::base::prf::{MasterSecret, Prf};
use guard4d_engine::evidence::message::{MAX_MESSAGE_BITS, Message};
use guard4d_engine::watermark::key::tokens::{TokenTable, Vocabulary};
use proptest::prelude::*;

const CLIP: Vocabulary = Vocabulary { size: 49_408, context: 77 };

fn prf(seed: u8) -> Prf {
    Prf::new(&MasterSecret::from_bytes([seed; 32]))
}

#[test]
fn clip_table_uses_distinct_ids_between_pad_and_begin() {
    let table = TokenTable::derive(&prf(1), CLIP, 75).expect("75 is the most");
    let ids: HashSet<u32> = table.ids().iter().flatten().copied().collect();
    assert_eq!(ids.len(), 150);
    assert!(ids.iter().all(|id| (1..=49_405).contains(id)), "{ids:?}");
    assert_eq!((CLIP.begin(), CLIP.end(), CLIP.max_bits()), (49_406, 49_407, 75));
}

#[test]
fn sequence_is_begin_bits_end() {
    let table = TokenTable::derive(&prf(1), CLIP, 4).expect("4 bits");
    let message = Message::from_value(0b0110, 4).expect("4 bits");
    let ids = table.ids();
    let want = [49_406, ids[0][0], ids[1][1], ids[2][1], ids[3][0], 49_407];
    assert_eq!(table.sequence(&message).expect("equal lengths"), want);
    let long = Message::from_value(0, 5).expect("5 bits");
    assert_eq!(table.sequence(&long).expect_err("lengths differ").exit_code(), 2);
}

#[test]
fn tables_depend_on_the_key_alone() {
    let table = |seed| TokenTable::derive(&prf(seed), CLIP, 16).expect("16 bits");
    assert_eq!(table(1), table(1));
    assert_ne!(table(1), table(2));
    assert_ne!(table(1).digest(), table(2).digest());
    // Frozen: keys that users hold must give the same table in every version. The values come from an
    // independent implementation in Python.
    assert_eq!(table(1).ids()[..2], [[38_967, 38_989], [27_030, 33_147]]);
}

#[test]
fn too_many_bits_are_refused_with_the_limit() {
    let error = TokenTable::derive(&prf(1), CLIP, 76).expect_err("76 bits");
    assert_eq!(error.exit_code(), 2);
    assert!(error.to_string().contains("1 to 75 bits"), "{error}");
    assert!(TokenTable::derive(&prf(1), CLIP, 0).is_err(), "no bits");
    let long = Vocabulary { context: 248, ..CLIP };
    assert!(TokenTable::derive(&prf(1), long, MAX_MESSAGE_BITS).is_ok(), "the longest message");
    let error = TokenTable::derive(&prf(1), long, MAX_MESSAGE_BITS + 1).expect_err("no message is longer");
    assert!(error.to_string().contains("1 to 128 bits"), "{error}");
    for (size, context) in [(0, 0), (1, 1), (2, 77), (3, 77), (4, 77), (49_408, 2)] {
        assert!(TokenTable::derive(&prf(1), Vocabulary { size, context }, 1).is_err(), "{size} {context}");
    }
}

proptest! {
    #[test]
    fn small_vocabularies_give_distinct_usable_ids(size in 5_u32..60, context in 3_u32..40, seed: u8) {
        let vocabulary = Vocabulary { size, context };
        let num_bits = vocabulary.max_bits();
        let table = TokenTable::derive(&prf(seed), vocabulary, num_bits).expect("the most it holds");
        let ids: HashSet<u32> = table.ids().iter().flatten().copied().collect();
        prop_assert_eq!(ids.len() as u32, 2 * num_bits);
        prop_assert!(ids.iter().all(|&id| id >= 1 && id <= size - 3));
    }
}
