//! Signatures: the published test vectors, and what is refused.

use guard4d_engine::base::signature::{PublicKey, Signature, SigningKey};

/// RFC 8032, section 7.1, tests 1 and 3: secret, public key, message, signature.
const VECTORS: [[&str; 4]; 2] = [
    [
        "9d61b19deffd5a60ba844af492ec2cc44449c5697b326919703bac031cae7f60",
        "d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a",
        "",
        "e5564300c360ac729086e2cc806e828a84877f1eb8e5d974d873e065224901555fb8821590a33bacc61e39701cf9b46bd25bf5f0595b\
         be24655141438e7a100b",
    ],
    [
        "c5aa8df43f9f837bedb7442f31dcb7b166d38535076f094b85ce3a2e0b4458f7",
        "fc51cd8e6218a1a38da47ed00230f0580816ed13ba3303ac5deb911548908025",
        "af82",
        "6291d657deec24024827e69c3abe01a30ce548a284743a445e3680d7db5ac3ac18ff9b538d16f290ae67f760984dc6594a7c15e9716e\
         d28dc027beceea1ec40a",
    ],
];

fn bytes(hex: &str) -> Vec<u8> {
    let digits: Vec<u8> = hex.bytes().map(|d| (d as char).to_digit(16).expect("a digit") as u8).collect();
    digits.chunks(2).map(|pair| 16 * pair[0] + pair[1]).collect()
}

fn signature(hex: &str) -> Signature {
    serde_json::from_value(hex.into()).expect("a signature")
}

#[test]
fn published_signatures_are_made_and_accepted() {
    for [seed, public, message, expected] in VECTORS {
        let key = SigningKey::from_seed(&bytes(seed).try_into().expect("32 bytes"));
        assert_eq!(key.public_key().to_string(), public);
        assert_eq!(key.sign(&bytes(message)), signature(expected));
        assert!(key.public_key().has_signed(&bytes(message), &signature(expected)), "{public}");
    }
}

#[test]
fn changed_messages_signatures_and_weak_keys_are_refused() {
    let key = SigningKey::from_seed(&[3; 32]);
    let signed = key.sign(b"text");
    assert!(key.public_key().has_signed(b"text", &signed), "as it is");
    assert!(!key.public_key().has_signed(b"texts", &signed), "another message");
    assert!(!SigningKey::from_seed(&[4; 32]).public_key().has_signed(b"text", &signed), "another key");
    let hex = serde_json::to_value(signed).expect("digits").as_str().expect("text").to_owned();
    for at in 0..128 {
        let other = if hex.as_bytes()[at] == b'0' { "1" } else { "0" };
        let changed = format!("{}{other}{}", &hex[..at], &hex[at + 1..]);
        assert!(!key.public_key().has_signed(b"text", &signature(&changed)), "digit {at}");
    }
    // Under the neutral element, a signature of zeros fits every text unless keys of small order are refused.
    let neutral = PublicKey::from_hex(&format!("01{}", "00".repeat(31))).expect("64 digits");
    let zeros = signature(&format!("01{}", "00".repeat(63)));
    assert!(!neutral.has_signed(b"text", &zeros), "a key of small order");
    for text in ["", "00", &"0g".repeat(32), &"00".repeat(33)] {
        assert_eq!(PublicKey::from_hex(text), None, "{text}");
    }
}

#[test]
fn what_signs_is_not_shown() {
    let shown = format!("{:?}", SigningKey::from_seed(&[0xab; 32]));
    assert!(shown.starts_with("SigningKey(of ") && !shown.contains("abab"), "{shown}");
}
