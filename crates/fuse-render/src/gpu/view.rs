//! What the shaders know of a camera, made in double precision.

use fuse_camera::Camera;

use crate::cpu::raster::{LANES, SAMPLES};

/// `View` of common.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub(super) struct View {
    rows: [[[f32; 4]; 2]; LANES],
    forward: [f32; 3],
    near: f32,
    eye: [f32; 3],
    width: u32,
    eye_low: [f32; 3],
    height: u32,
    ray: [[f32; 4]; 3],
}

impl View {
    pub fn new(camera: &Camera, near: f32) -> Self {
        let k = &camera.intrinsics;
        let rotation = camera.pose.rotation.to_rotation_matrix();
        let row = |i: usize| -> [f64; 3] { std::array::from_fn(|j| rotation[(i, j)]) };
        let (right, down, forward) = (row(0), row(1), row(2));
        let (width, height) = (f64::from(k.width), f64::from(k.height));
        // `a * x + b * y`, in single precision, zero in the fourth place.
        let mix = |a: f64, x: &[f64; 3], b: f64, y: &[f64; 3]| -> [f32; 4] {
            std::array::from_fn(|i| if i < 3 { (a * x[i] + b * y[i]) as f32 } else { 0.0 })
        };
        let rows = SAMPLES.map(|sample| {
            // The sample of each pixel is moved to where the rasteriser tests: its centre.
            let [cx, cy] = [k.cx - f64::from(sample[0]), k.cy - f64::from(sample[1])];
            [
                mix(2.0 * k.fx / width, &right, 2.0 * cx / width - 1.0, &forward),
                // Clip space has y up.
                mix(-2.0 * k.fy / height, &down, 1.0 - 2.0 * cy / height, &forward),
            ]
        });
        let (x, y) = ((0.5 * width - k.cx) / k.fx, (0.5 * height - k.cy) / k.fy);
        let middle: [f64; 3] = std::array::from_fn(|i| right[i] * x + down[i] * y);
        let center = camera.pose.center();
        let eye = [center.x, center.y, center.z];
        Self {
            rows,
            forward: forward.map(|v| v as f32),
            near,
            eye: eye.map(|v| v as f32),
            width: k.width,
            eye_low: eye.map(|v| (v - f64::from(v as f32)) as f32),
            height: k.height,
            ray: [
                mix(1.0, &middle, 1.0, &forward),
                mix(1.0 / k.fx, &right, 0.0, &down),
                mix(0.0, &right, 1.0 / k.fy, &down),
            ],
        }
    }
}
