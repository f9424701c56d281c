//! Light of a scene: one spherical key light and a soft-box room around it.
//!
//! All colours are linear sRGB. A diffuse white surface under irradiance `E` reflects `E / π`;
//! irradiances here are given already divided by π, so 1 means "as bright as white paper in the
//! picture" at exposure 1.

use glam::Vec3;

/// A bright patch of the surroundings, seen in reflections and felt as fill light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SoftBox {
    /// Direction towards the patch (made unit length when the renderer is built).
    pub direction: Vec3,
    /// Radiance at its middle.
    pub color: Vec3,
    /// Falloff: radiance is `color / (1 + sharpness (1 - cos θ))²`; 4 is broad, 60 a window.
    pub sharpness: f32,
}

/// Key light with soft shadow, and ambient surroundings.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// Centre of the spherical key light in the world, metres.
    pub position: Vec3,
    /// Its radius, metres; the larger, the softer the shadows.
    pub radius: f32,
    /// Its irradiance over π at one metre, facing it.
    pub intensity: Vec3,
    /// Ambient radiance from above.
    pub sky: Vec3,
    /// Ambient radiance from below.
    pub ground: Vec3,
    /// Bright patches of the surroundings.
    pub soft_boxes: Vec<SoftBox>,
    /// Factor on the radiance before the tone curve.
    pub exposure: f32,
}

impl Default for Light {
    /// A ceiling lamp beside the table, daylight from a window.
    fn default() -> Self {
        Self {
            position: Vec3::new(0.9, -0.8, 2.45),
            radius: 0.16,
            intensity: Vec3::new(3.9, 3.7, 3.35),
            sky: Vec3::new(0.21, 0.225, 0.25),
            ground: Vec3::new(0.12, 0.105, 0.09),
            soft_boxes: vec![
                SoftBox { direction: Vec3::new(-0.8, 0.35, 0.5), color: Vec3::new(1.1, 1.25, 1.5), sharpness: 14.0 },
                SoftBox { direction: Vec3::new(0.5, 0.75, 0.45), color: Vec3::new(0.9, 0.85, 0.75), sharpness: 30.0 },
            ],
            exposure: 1.0,
        }
    }
}
