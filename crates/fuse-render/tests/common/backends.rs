//! One test body for every backend that is compiled in.

use fuse_camera::{Camera, DepthBuffer, IdBuffer};
use fuse_render::{Frame, RenderOptions, Renderer, Scene};

/// A scene prepared on one backend.
pub struct Prepared {
    /// `cpu` or `gpu`.
    pub name: &'static str,
    inner: Inner,
}

enum Inner {
    Cpu(Box<Renderer>),
    #[cfg(feature = "gpu")]
    Gpu(Box<fuse_render::gpu::GpuRenderer>),
}

impl Prepared {
    pub fn render(&self, camera: &Camera) -> Frame {
        match &self.inner {
            Inner::Cpu(r) => r.render(camera),
            #[cfg(feature = "gpu")]
            Inner::Gpu(r) => r.render(camera).expect("a frame"),
        }
    }

    pub fn depth_ids(&self, camera: &Camera) -> (DepthBuffer, IdBuffer) {
        match &self.inner {
            Inner::Cpu(r) => r.depth_ids(camera),
            #[cfg(feature = "gpu")]
            Inner::Gpu(r) => r.depth_ids(camera).expect("depth and ids"),
        }
    }

    /// Largest relative error of a depth that only rounding may cause.
    pub fn rounding(&self) -> f64 {
        if self.name == "cpu" { 1e-6 } else { 1e-4 }
    }
}

/// The scene on every backend: the CPU, and with the feature `gpu` a GPU.
pub fn backends(scene: &Scene, options: &RenderOptions) -> Vec<Prepared> {
    let cpu = Renderer::new(scene.clone(), options).expect("a sound scene");
    #[cfg_attr(not(feature = "gpu"), allow(unused_mut))]
    let mut all = vec![Prepared { name: "cpu", inner: Inner::Cpu(Box::new(cpu)) }];
    #[cfg(feature = "gpu")]
    all.extend(super::gpu::device().map(|device| {
        let gpu = fuse_render::gpu::GpuRenderer::new(scene.clone(), options, &device).expect("a sound scene");
        Prepared { name: "gpu", inner: Inner::Gpu(Box::new(gpu)) }
    }));
    all
}
