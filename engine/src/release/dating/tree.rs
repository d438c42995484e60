//! One hash over many commitments, and proofs that a commitment is one of them.
//!
//! The shape of the tree is that of RFC 9162, section 2.1, and so are the first bytes of what is hashed: 0 before a
//! leaf, 1 before a pair. The hash is BLAKE3 in a domain of its own. Last, 2, the number of leaves (64 bits, little
//! endian) and the tree's head are hashed together, so that nobody can call a large tree a small one.

use crate::base::digest::Digest;

/// Domain of all hashes of a tree.
const CONTEXT: &str = "guard4d tree of receipt commitments, version 1";

/// Most leaves of a tree: their list takes 70 MB.
pub const MAX_LEAVES: u32 = 1 << 20;

/// First byte of what is hashed.
#[derive(Clone, Copy)]
enum Kind {
    Leaf = 0,
    Pair = 1,
    Root = 2,
}

fn hash(kind: Kind, parts: [&[u8]; 2]) -> Digest {
    let mut hasher = blake3::Hasher::new_derive_key(CONTEXT);
    hasher.update(&[kind as u8]);
    parts.iter().for_each(|part| _ = hasher.update(part));
    Digest::from_bytes(*hasher.finalize().as_bytes())
}

fn leaf(commitment: &Digest) -> Digest {
    hash(Kind::Leaf, [commitment.as_bytes(), &[]])
}

fn pair(left: &Digest, right: &Digest) -> Digest {
    hash(Kind::Pair, [left.as_bytes(), right.as_bytes()])
}

fn close(head: &Digest, leaves: u64) -> Digest {
    hash(Kind::Root, [&leaves.to_le_bytes(), head.as_bytes()])
}

/// Where RFC 9162 splits a tree: the largest power of two below `leaves`, which are at least two.
fn split(leaves: usize) -> usize {
    leaves.next_power_of_two() / 2
}

fn head(commitments: &[Digest]) -> Digest {
    match commitments {
        [one] => leaf(one),
        // That a tree without leaves is refused, callers see to.
        many => {
            let (left, right) = many.split_at(split(many.len()));
            pair(&head(left), &head(right))
        }
    }
}

/// The root of commitments in their order; none without a commitment.
#[must_use]
pub fn root_of(commitments: &[Digest]) -> Option<Digest> {
    (!commitments.is_empty()).then(|| close(&head(commitments), commitments.len() as u64))
}

/// The heads beside the way from the leaf `index` to the tree's head, lowest first (RFC 9162, section 2.1.3.1).
///
/// # Panics
/// If there is no such leaf.
#[must_use]
pub fn path_of(commitments: &[Digest], index: usize) -> Vec<Digest> {
    assert!(index < commitments.len(), "leaf {index} of {}", commitments.len());
    let (mut part, mut index, mut path) = (commitments, index, Vec::new());
    while part.len() > 1 {
        let (left, right) = part.split_at(split(part.len()));
        if index < left.len() {
            path.push(head(right));
            part = left;
        } else {
            path.push(head(left));
            (part, index) = (right, index - left.len());
        }
    }
    path.reverse();
    path
}

/// The root that `commitment` belongs to as the leaf `index` of `leaves`, if the heads of `path` stand beside its way
/// (RFC 9162, section 2.1.3.2). None where there is no such leaf or the way has another length.
#[must_use]
pub fn root_along(commitment: &Digest, index: u64, leaves: u64, path: &[Digest]) -> Option<Digest> {
    if index >= leaves {
        return None;
    }
    let (mut at, mut last, mut current) = (index, leaves - 1, leaf(commitment));
    for beside in path {
        if last == 0 {
            return None;
        }
        if at % 2 == 1 || at == last {
            current = pair(beside, &current);
            // The last of an odd row goes up alone, until it has a neighbour.
            while at.is_multiple_of(2) && at != 0 {
                (at, last) = (at / 2, last / 2);
            }
        } else {
            current = pair(&current, beside);
        }
        (at, last) = (at / 2, last / 2);
    }
    (last == 0).then(|| close(&current, leaves))
}
