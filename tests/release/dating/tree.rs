//! Trees of commitments: their shape, their roots, and the ways from leaves to roots.

use guard4d_engine::base::digest::Digest;
use guard4d_engine::release::dating::tree::{Tree, root_along};

fn leaves(n: usize) -> Vec<Digest> {
    (0..n).map(|i| Digest::of(&i.to_le_bytes())).collect()
}

fn tree(leaves: &[Digest]) -> Tree {
    Tree::over(leaves).expect("there are leaves")
}

fn hash(parts: &[&[u8]]) -> Digest {
    let mut hasher = blake3::Hasher::new_derive_key("guard4d tree of receipt commitments, version 1");
    parts.iter().for_each(|part| _ = hasher.update(part));
    Digest::from_bytes(*hasher.finalize().as_bytes())
}

/// The definition of RFC 9162, section 2.1.1, written down again.
fn head(leaves: &[Digest]) -> Digest {
    match leaves {
        [one] => hash(&[&[0], one.as_bytes()]),
        many => {
            let split =
                (0..).map(|power| 1_usize << power).take_while(|k| *k < many.len()).last().expect("two or more");
            let (left, right) = many.split_at(split);
            hash(&[&[1], head(left).as_bytes(), head(right).as_bytes()])
        }
    }
}

#[test]
fn roots_are_those_of_the_definition_with_the_number_of_leaves() {
    for n in 1..=33 {
        let leaves = leaves(n);
        let expected = hash(&[&[2], &(n as u64).to_le_bytes(), head(&leaves).as_bytes()]);
        assert_eq!(tree(&leaves).root(), expected, "{n} leaves");
    }
    assert!(Tree::over(&[]).is_none(), "nothing has no root");
}

#[test]
fn every_leaf_leads_to_the_root_and_nothing_else_does() {
    for n in 1..=33_u64 {
        let leaves = leaves(n as usize);
        let tree = tree(&leaves);
        let root = Some(tree.root());
        assert_eq!(tree.path(n as usize), None, "no such leaf");
        for index in 0..n {
            let (leaf, path) = (leaves[index as usize], tree.path(index as usize).expect("a leaf"));
            assert_eq!(root_along(&leaf, index, n, &path), root, "leaf {index} of {n}");
            let other = Digest::of(b"another");
            assert_ne!(root_along(&other, index, n, &path), root, "another leaf at {index} of {n}");
            assert_ne!(root_along(&leaf, index, n + 1, &path), root, "one leaf more");
            for fewer in [1, n / 2, n - 1].into_iter().filter(|fewer| *fewer < n) {
                assert_ne!(root_along(&leaf, index.min(fewer.saturating_sub(1)), fewer, &path), root, "{fewer} of {n}");
            }
            for elsewhere in (0..n).filter(|elsewhere| *elsewhere != index) {
                assert_ne!(root_along(&leaf, elsewhere, n, &path), root, "leaf {index} of {n} at {elsewhere}");
            }
            let longer = [&path[..], &[other]].concat();
            assert_eq!(root_along(&leaf, index, n, &longer), None, "a longer way");
            if let Some((_, shorter)) = path.split_last() {
                assert_eq!(root_along(&leaf, index, n, shorter), None, "a shorter way");
            }
        }
        assert_eq!(root_along(&leaves[0], n, n, &[]), None, "no such leaf");
    }
    assert_eq!(root_along(&leaves(1)[0], 0, 0, &[]), None, "no leaf at all");
}
