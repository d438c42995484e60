//! Files that hold evidence, damaged: each is refused, or says what it said before.

use std::fs;
use std::path::Path;

use guard4d_engine::release::delivery::EXTRACTOR;
use guard4d_engine::release::receipt::Receipt;
use guard4d_engine::watermark::extractor::weights::ExtractorWeights;
use guard4d_engine::watermark::key::owner_key::Key;

use crate::support::gpu::device;
use crate::support::owner::{Owner, delivered};
use crate::support::random::Random;

/// Flips of each of the three files; 12,000 in all.
const FLIPS: usize = 4000;

/// Tries `read` on a file with one bit flipped, [`FLIPS`] times, and cut off at a hundred places. `read` is true where
/// the file says what it said before, and false where it was refused.
fn damage(file: &Path, seed: u64, read: impl Fn(&Path) -> bool) {
    let whole = fs::read(file).expect("it is there");
    let (mut random, mut refused) = (Random(seed), 0);
    assert!(read(file), "{} as it is", file.display());
    for _ in 0..FLIPS {
        let (at, bit) = (random.below(whole.len()), random.below(8));
        let mut bytes = whole.clone();
        bytes[at] ^= 1 << bit;
        fs::write(file, &bytes).expect("writable");
        refused += usize::from(!read(file));
    }
    for part in 0..100 {
        fs::write(file, &whole[..whole.len() * part / 100]).expect("writable");
        assert!(!read(file), "{} of {} bytes", whole.len() * part / 100, whole.len());
    }
    fs::write(file, &whole).expect("writable");
    // White space of a receipt may change; little of it is any.
    assert!(refused > FLIPS / 2, "{refused} of {FLIPS} refused");
}

#[test]
fn flipped_and_truncated_evidence_is_refused_or_unchanged() {
    let Some(gpu) = device() else { return };
    let (owner, folder) = (Owner::new(&gpu), tempfile::tempdir().expect("a temporary folder"));
    let copy = |from: &str, name: &str| {
        let to = folder.path().join(name);
        fs::copy(delivered(&gpu).join(from), &to).expect("it is there");
        to
    };
    let (key_file, receipt_file) = (copy("owner.key", "owner.key"), copy("out/private/receipt.json", "receipt.json"));
    let extractor_file = copy("out/private/extractor.safetensors", EXTRACTOR);
    let receipt = Receipt::read(&receipt_file).expect("our own receipt");
    let owner_key = Key::read(&key_file, &owner.clip).expect("our own key");
    let key = receipt.body.promise.key_for(&owner_key).expect("of the asset");

    damage(&receipt_file, 1, |path| Receipt::read(path).is_ok_and(|read| same(&read, &receipt)));
    damage(&key_file, 2, |path| {
        Key::read(path, &owner.clip).is_ok_and(|read| {
            assert!(
                read.prf().key_id() == owner_key.prf().key_id() && read.codes == owner_key.codes,
                "read as another"
            );
            assert!(read.decoder == owner_key.decoder && read.text_mean == owner_key.text_mean, "read as another");
            true
        })
    });
    damage(&extractor_file, 3, |path| {
        let read = ExtractorWeights::read(path, &key).and_then(|extractor| extractor.digest(&key));
        read.is_ok_and(|digest| receipt.body.promise.extractor == Some(digest))
    });
}

/// A receipt that is read from a damaged file must be the one that was sealed.
fn same(read: &Receipt, sealed: &Receipt) -> bool {
    assert_eq!(read, sealed, "read as another");
    true
}
