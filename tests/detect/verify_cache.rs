//! What verifications after the first need not do again.

use std::num::NonZeroU32;

use guard4d_engine::detect::report::VerifyReport;
use guard4d_engine::detect::request::{VerifyInputs, VerifyRequest};
use guard4d_engine::detect::suspect::Suspect;
use guard4d_engine::detect::verify_cache::VerifyCache;
use guard4d_engine::media::{Frame, ReadOptions};
use guard4d_engine::scene::Model;

use crate::support::gpu::{Gpu, own_device};
use crate::support::owner::{Owner, delivered};

/// One verification, and how many buffers it made.
fn verified(gpu: &Gpu, owner: &Owner, original: Option<&Model>, cache: &VerifyCache) -> (VerifyReport, u64) {
    let frames = (0..8).map(|i| Frame::new(32, 32, vec![20 * i; 32 * 32 * 3]).expect("a size")).collect();
    let suspects = vec![Suspect::Frames { name: "film".to_owned(), frames }];
    let request = VerifyRequest {
        device: gpu,
        clip: &owner.clip,
        key: &owner.key,
        sought: None,
        receipt: &delivered(gpu).join("out/private/receipt.json"),
        pretrained: None,
        original,
        trusted_clip: None,
        claims: NonZeroU32::MIN,
        cache,
    };
    let before = gpu.memory_use().allocations;
    let inputs = VerifyInputs { suspects, ..VerifyInputs::default() };
    let report = request.verify(&inputs, &ReadOptions::default()).expect("verifies");
    (report, gpu.memory_use().allocations - before)
}

#[test]
fn films_of_one_asset_are_compared_with_what_was_made_for_the_first() {
    let Some(gpu) = own_device() else { return };
    let (owner, cache) = (Owner::new(&gpu), VerifyCache::default());
    // Whatever it takes to make the delivery is not counted.
    delivered(&gpu);
    let (first, made) = verified(&gpu, &owner, Some(&owner.model), &cache);
    let (second, again) = verified(&gpu, &owner, Some(&owner.model), &cache);
    assert_eq!((&first.evidence, first.free_part), (&second.evidence, second.free_part), "the same to the bit");
    assert!(again < made / 4, "of {made} buffers {again} were made again");

    // Without the original nothing is fitted: what is spared are the program's own clips.
    let (bare, filmed) = verified(&gpu, &owner, None, &VerifyCache::default());
    let (held, once) = verified(&gpu, &owner, None, &cache);
    assert_eq!(bare.evidence, held.evidence);
    assert!(once < filmed, "of {filmed} buffers {once} were made again");

    cache.forget();
    let (_, anew) = verified(&gpu, &owner, Some(&owner.model), &cache);
    assert!(anew > made / 2, "on another device all is made again: {anew} of {made}");
}
