//! Keys under a passphrase.

use std::fs;
use std::path::Path;

use guard4d_engine::base::output::Existing;
use guard4d_engine::error::EngineError;
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::watermark::key::owner_key::Key;
use guard4d_engine::watermark::key::passphrase::Passphrase;

use crate::support::gpu::device;
use crate::support::owner::key_of;

/// A passphrase in a file.
fn passphrase(folder: &Path, text: &str) -> Result<Passphrase, EngineError> {
    let path = folder.join("passphrase");
    fs::write(&path, text).expect("writable");
    Passphrase::read(&path)
}

#[test]
fn a_sealed_key_opens_with_its_passphrase_alone() {
    let Some(gpu) = device() else { return };
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let [plain, sealed] = ["plain.key", "sealed.key"].map(|name| folder.path().join(name));
    let clip = ClipModel::load(&gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
    let key = key_of(&clip, [9; 32], 8);
    let right = passphrase(folder.path(), "correct horse\nwhat follows is a note\n").expect("a passphrase");
    key.write(&plain, Existing::Refuse).expect("writable");
    key.write_sealed(&sealed, Existing::Refuse, &right).expect("writable");
    let bytes = fs::read(&sealed).expect("written");
    let holds = |bytes: &[u8], words: &str| bytes.windows(words.len()).any(|window| window == words.as_bytes());
    let secret = "09".repeat(32);
    assert!(holds(&fs::read(&plain).expect("written"), &secret), "a plain key says its secret");
    assert!(!holds(&bytes, &secret) && !holds(&bytes, "token_table"), "a sealed one nothing");
    assert!(bytes.starts_with(b"age-encryption.org/v1\n-> scrypt "), "a file of the age format");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        assert_eq!(fs::metadata(&sealed).expect("written").permissions().mode() & 0o777, 0o600, "for its owner alone");
    }

    let again = folder.path().join("again.key");
    let back = Key::read_sealed(&sealed, &clip, Some(&right)).expect("our own key");
    back.write(&again, Existing::Refuse).expect("writable");
    assert!(fs::read(&again).expect("written") == fs::read(&plain).expect("written"), "the same key");
    Key::read_sealed(&plain, &clip, Some(&right)).expect("a plain key needs none, and takes one");

    let wrong = passphrase(folder.path(), "correct horse \n").expect("another one: spaces count");
    let refused = |path: &Path, passphrase: Option<&Passphrase>, words: &str| {
        let error = Key::read_sealed(path, &clip, passphrase).expect_err("no key").to_string();
        assert!(error.contains("sealed.key: age") && error.contains(words), "{error}");
    };
    refused(&sealed, Some(&wrong), "a file that the passphrase opens");
    refused(&sealed, None, "--passphrase-file");
    // Work of 2^30 would keep the program busy for an hour; a byte in the middle belongs to the key.
    let line = bytes.iter().enumerate().filter(|(_, byte)| **byte == b'\n').nth(1).expect("two lines").0;
    assert_eq!(&bytes[line - 3..line], b" 18", "the work that a guess takes");
    let mut hard = bytes.clone();
    hard[line - 2..line].copy_from_slice(b"30");
    let mut flipped = bytes.clone();
    flipped[bytes.len() / 2] ^= 1;
    for changed in [&hard, &flipped, &bytes[..bytes.len() - 1].to_vec()] {
        fs::write(&sealed, changed).expect("writable");
        refused(&sealed, Some(&right), "a file that the passphrase opens");
    }
}

#[test]
fn what_is_no_passphrase_is_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    for text in ["", "\n", "\nsecond line"] {
        let error = passphrase(folder.path(), text).err().expect("no passphrase").to_string();
        assert!(error.contains("passphrase: first line"), "{error}");
    }
    fs::write(folder.path().join("binary"), [0xff, 0xfe]).expect("writable");
    assert!(matches!(Passphrase::read(&folder.path().join("binary")), Err(EngineError::BadData { .. })), "no text");
    assert!(matches!(Passphrase::read(&folder.path().join("none")), Err(EngineError::MissingInput { .. })), "no file");
}
