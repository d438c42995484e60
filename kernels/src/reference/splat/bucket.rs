//! Twin of `splat/bucket_keys`.

/// Bucket of each depth between the nearest and the farthest of a scene's box, of `buckets`; 0 is nearest.
#[must_use]
pub fn keys(depths: &[f64], [nearest, farthest]: [f64; 2], buckets: u32) -> Vec<u32> {
    let camera = (32.0 * farthest / (farthest - nearest)).floor().clamp(0.0, 31.0);
    let weights: Vec<f64> = (0..32)
        .map(|bin| match (f64::from(bin) - camera).abs() {
            0.0 => 40.0,
            apart if apart <= 2.0 => 20.0,
            apart if apart <= 5.0 => 8.0,
            apart if apart <= 10.0 => 3.0,
            _ => 1.0,
        })
        .collect();
    let total: f64 = weights.iter().sum();
    let shares: Vec<f64> =
        weights.iter().map(|weight| (weight / total * f64::from(buckets)).floor().max(1.0)).collect();
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most as many as buckets")]
    let whole = |number: f64| number.floor() as u32;
    let key = |depth: &f64| {
        let place = (32.0 * (farthest - depth) / (farthest - nearest)).clamp(0.0, 31.999);
        let bin = whole(place) as usize;
        let before: f64 = shares.iter().take(bin).sum();
        buckets - whole(before + (shares[bin] * place.fract()).floor()).min(buckets)
    };
    depths.iter().map(key).collect()
}
