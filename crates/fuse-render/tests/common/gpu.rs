//! The GPU that the tests run on.

use std::sync::OnceLock;

use fuse_camera::gpu::{Gpu, Software};
use fuse_render::gpu::Device;

/// A real GPU if there is one, else an emulated one; `None` only where the environment variable
/// `FUSE_NO_GPU_TESTS=1` says that none is wanted.
///
/// # Panics
/// If there is no adapter at all: tests that did not run must not look as if they had passed.
pub fn device() -> Option<Device> {
    static DEVICE: OnceLock<Option<Device>> = OnceLock::new();
    DEVICE
        .get_or_init(|| {
            if std::env::var("FUSE_NO_GPU_TESTS").is_ok_and(|v| v == "1") {
                println!("FUSE_NO_GPU_TESTS=1: not run");
                return None;
            }
            let gpu = Gpu::open(Software::Allowed).unwrap_or_else(|e| {
                panic!(
                    "{e}\nThe GPU tests need a Vulkan adapter; one that needs no hardware comes with \
                     `apt-get install mesa-vulkan-drivers libvulkan1`. FUSE_NO_GPU_TESTS=1 leaves these tests out."
                )
            });
            println!("GPU tests run on {}", gpu.name());
            Some(Device::new(gpu).expect("the stages compile"))
        })
        .clone()
}
