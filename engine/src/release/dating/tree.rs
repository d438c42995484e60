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

/// A tree over commitments, with all that proofs are made of.
#[derive(Clone, Debug)]
pub struct Tree {
    /// Hashes of the leaves, then of ever larger parts; the last row is the head alone. The last of an odd row goes up
    /// as it is, which gives the shape of RFC 9162: there the left part has as many leaves as fit a full tree.
    rows: Vec<Vec<Digest>>,
}

impl Tree {
    /// The tree over commitments in their order; none without a commitment.
    #[must_use]
    pub fn over(commitments: &[Digest]) -> Option<Self> {
        let mut row: Vec<Digest> = commitments.iter().map(leaf).collect();
        let mut rows = Vec::new();
        while row.len() > 1 {
            let above = row.chunks(2).map(|two| two.get(1).map_or(two[0], |right| pair(&two[0], right))).collect();
            rows.push(std::mem::replace(&mut row, above));
        }
        let is_there = !row.is_empty();
        rows.push(row);
        is_there.then_some(Self { rows })
    }

    /// The root.
    #[must_use]
    pub fn root(&self) -> Digest {
        let head = self.rows.last().expect("the row of the head is always there");
        close(&head[0], self.rows[0].len() as u64)
    }

    /// The heads beside the way from the leaf `index` to the tree's head, lowest first (RFC 9162, section 2.1.3.1).
    /// None where there is no such leaf.
    #[must_use]
    pub fn path(&self, index: usize) -> Option<Vec<Digest>> {
        let beside = |(height, row): (usize, &Vec<Digest>)| row.get((index >> height) ^ 1).copied();
        (index < self.rows[0].len()).then(|| self.rows.iter().enumerate().filter_map(beside).collect())
    }
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
