//! nn/pack: both packers against the twin, through the product that reads the packed order.

use guard4d_kernels::KernelError;
use guard4d_kernels::nn::matmul::{Product, forward};
use guard4d_kernels::nn::pack::{Order, PackedWeight, Precision, gather};
use guard4d_kernels::reference::nn::pack as twin;

use super::{run, unwritten, upload};
use crate::support::gpu::device;
use crate::support::poison;
use crate::support::random::Random;

/// The unit matrix times Wᵀ gives W's padded transpose back, exactly.
fn unpacked(gpu: &guard4d_kernels::Device, weight: &PackedWeight) -> Vec<f32> {
    let (n, k) = (weight.n(), weight.k());
    let unit: Vec<f32> = (0..k * k).map(|i| if i % k == i / k { 1.0 } else { 0.0 }).collect();
    let (unit, mut c) = (upload(gpu, &unit), unwritten(gpu, k * n));
    run(gpu, |rec| forward(rec, &Product::plain(&unit, k, weight), &mut c));
    c.read().expect("read")
}

#[test]
fn twin_places_each_element_once() {
    let w: Vec<f64> = (1..=9 * 5).map(f64::from).collect();
    let packed = twin::rows(&w, 9, 5);
    assert_eq!(packed.len(), 16 * 8, "padded to 16 x 8");
    assert_eq!(packed.iter().sum::<f64>(), w.iter().sum::<f64>(), "nothing lost, nothing doubled");
    assert_eq!(packed[0..8], [1.0, 2.0, 3.0, 4.0, 6.0, 7.0, 8.0, 9.0], "lanes 0 and 1 of the first fetch");
}

#[test]
fn host_and_device_packing_agree_in_both_orders() {
    let Some(gpu) = device() else { return };
    for (n, k) in [(8, 4), (9, 5), (17, 12), (64, 30)] {
        let mut random = Random((n * k) as u64);
        let w = random.vec_f32(n * k, -1.0, 1.0);
        let w_t: Vec<f32> = (0..n * k).map(|i| w[(i % n) * k + i / n]).collect();
        let host = unpacked(&gpu, &PackedWeight::new(&gpu, "w", &w, n, k).expect("packs"));
        for row in 0..n {
            for col in 0..k {
                assert_eq!(host[col * n.next_multiple_of(8) + row], w[row * k + col], "W({row}, {col})");
            }
        }
        let transposed = PackedWeight::transposed(&gpu, "w", &w_t, n, k, Precision::F32).expect("packs");
        assert_eq!(unpacked(&gpu, &transposed), host, "transposed on the host");
        for (source, order) in [(&w, Order::Rows { stride: k }), (&w_t, Order::Columns { stride: n })] {
            let mut packed = PackedWeight::zeros(&gpu, "w", n, k).expect("buffer");
            let source = upload(&gpu, source);
            run(&gpu, |rec| gather(rec, &source, order, &mut packed));
            assert_eq!(unpacked(&gpu, &packed), host, "{order:?}");
        }
    }
}

#[test]
fn both_packers_place_every_bit_as_the_twin_does() {
    let Some(gpu) = device() else { return };
    // W(8, 3) stands alone in the second block of lanes, beside padding.
    let (n, k) = (9, 5);
    let clean = Random(2).vec_f32(n * k, -1.0, 1.0);
    let on_host = |w: &[f32]| twin::rows(w, n, k);
    let packed = |weight: &PackedWeight| weight.packed().expect("floats").read().expect("read");
    let by_host = |w: &[f32]| packed(&PackedWeight::new(&gpu, "w", w, n, k).expect("packs"));
    let by_device = |w: &[f32]| {
        let mut weight = PackedWeight::zeros(&gpu, "w", n, k).expect("buffer");
        let source = upload(&gpu, w);
        run(&gpu, |rec| gather(rec, &source, Order::Rows { stride: k }, &mut weight));
        packed(&weight)
    };
    // Copies: nothing is rounded.
    let exact = (0.0, 0.0);
    assert_eq!(poison::spread(&clean, &[0, 8 * k + 3], exact, by_host, on_host), [1, 1], "on the host");
    assert_eq!(poison::spread(&clean, &[0, 8 * k + 3], exact, by_device, on_host), [1, 1], "on the device");
}

#[test]
fn a_wider_source_gives_its_top_left_part() {
    let Some(gpu) = device() else { return };
    let source: Vec<f32> = (0u8..40).map(f32::from).collect();
    let mut packed = PackedWeight::zeros(&gpu, "w", 3, 4).expect("buffer");
    let source_buffer = upload(&gpu, &source);
    run(&gpu, |rec| gather(rec, &source_buffer, Order::Rows { stride: 10 }, &mut packed));
    let got = unpacked(&gpu, &packed);
    assert_eq!([got[0], got[1], got[2], got[3]], [0.0, 10.0, 20.0, 0.0], "first k, then padding");
    assert_eq!(got[3 * 8 + 2], 23.0, "W(2, 3)");
}

#[test]
fn short_sources_are_refused_and_empty_is_fine() {
    let Some(gpu) = device() else { return };
    let mut packed = PackedWeight::zeros(&gpu, "w", 8, 4).expect("buffer");
    let source = upload(&gpu, &[0.0; 31]);
    let mut rec = gpu.recorder().expect("recorder");
    let wrong = gather(&mut rec, &source, Order::Rows { stride: 4 }, &mut packed);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "src", .. })), "{wrong:?}");
    let mut codes = PackedWeight::in_precision(&gpu, "w", &[0.0; 64], 16, 4, Precision::Fixed16).expect("packs");
    let refused = gather(&mut rec, &upload(&gpu, &[0.0; 64]), Order::Rows { stride: 4 }, &mut codes);
    assert!(matches!(refused, Err(KernelError::Shape { buffer: "out", .. })), "no packing into codes: {refused:?}");
    let mut none = PackedWeight::zeros(&gpu, "w", 0, 4).expect("buffer");
    run(&gpu, |rec| gather(rec, &source, Order::Rows { stride: 4 }, &mut none));
}
