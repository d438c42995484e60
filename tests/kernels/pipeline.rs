//! What a driver remembers of kernels from one device to the next.

use std::sync::{Arc, Mutex};

use guard4d_kernels::Device;
use guard4d_kernels::nn::axpy;

use crate::support::gpu::own_device;

/// What was handed out so far.
type Kept = Arc<Mutex<Vec<Vec<u8>>>>;

/// Has a device remember what is known, and runs a kernel on it.
fn run(device: &Device, known: &[u8], kept: &Kept) {
    let kept = Arc::clone(kept);
    let keep = move |data: &[u8]| kept.lock().expect("no test panics in it").push(data.to_vec());
    device.remember_pipelines(known, keep).expect("the driver takes its own data, or none");
    let [x, y] = [1.0f32, 2.0].map(|value| device.buffer_from("values", &[value; 8]).expect("buffer"));
    let mut sum = device.buffer("sum", 8).expect("buffer");
    let mut rec = device.recorder().expect("recorder");
    axpy::forward(&mut rec, 3.0, &x, &y, &mut sum).expect("records");
    rec.submit().expect("runs");
    assert_eq!(sum.read().expect("read"), [7.0; 8], "the kernel is as it was");
}

#[test]
fn what_a_driver_remembers_is_handed_out_when_the_device_goes_and_taken_back() {
    let kept = Kept::default();
    for number in 0..2 {
        let Some(gpu) = own_device() else { return };
        let known = kept.lock().expect("no test panics in it").last().cloned().unwrap_or_default();
        run(&gpu, &known, &kept);
        assert_eq!(kept.lock().expect("no test panics in it").len(), number, "not while the device is there");
        drop(gpu);
        let kept = kept.lock().expect("no test panics in it");
        assert_eq!(kept.len(), number + 1, "once for each device");
        // Vulkan's header: its length and its version come first.
        let head: Vec<u32> = kept[number].as_chunks().0.iter().take(2).map(|word| u32::from_le_bytes(*word)).collect();
        assert_eq!(head, [32, 1]);
    }
}
