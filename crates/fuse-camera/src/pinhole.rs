//! Pinhole intrinsics without distortion.

use nalgebra::Point3;

/// Why a set of intrinsics was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PinholeError {
    /// An image side is zero or larger than 16384 pixels.
    #[error("image size must be 1 to 16384 pixels a side, found {width}x{height}")]
    Size {
        /// Width found.
        width: u32,
        /// Height found.
        height: u32,
    },
    /// A focal length or principal point is not finite, or a focal length is not positive.
    #[error("{name} must be finite{}, found {value}", if *.positive { " and positive" } else { "" })]
    Value {
        /// Which parameter.
        name: &'static str,
        /// Value found.
        value: f64,
        /// Whether it must be positive too.
        positive: bool,
    },
}

/// Pinhole intrinsics, in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole {
    /// Image width.
    pub width: u32,
    /// Image height.
    pub height: u32,
    /// Focal length along x.
    pub fx: f64,
    /// Focal length along y.
    pub fy: f64,
    /// Principal point x, continuous coordinates.
    pub cx: f64,
    /// Principal point y, continuous coordinates.
    pub cy: f64,
}

impl Pinhole {
    /// Checked constructor.
    pub fn new(width: u32, height: u32, fx: f64, fy: f64, cx: f64, cy: f64) -> Result<Self, PinholeError> {
        if !(1..=16384).contains(&width) || !(1..=16384).contains(&height) {
            return Err(PinholeError::Size { width, height });
        }
        for (name, value, positive) in [("fx", fx, true), ("fy", fy, true), ("cx", cx, false), ("cy", cy, false)] {
            if !value.is_finite() || (positive && value <= 0.0) {
                return Err(PinholeError::Value { name, value, positive });
            }
        }
        Ok(Self { width, height, fx, fy, cx, cy })
    }

    /// Square pixels, principal point at the centre: `fx = fy = width / (2 tan(fov / 2))`.
    pub fn from_horizontal_fov(width: u32, height: u32, fov_rad: f64) -> Result<Self, PinholeError> {
        let f = f64::from(width) / (2.0 * (fov_rad / 2.0).tan());
        Self::new(width, height, f, f, f64::from(width) / 2.0, f64::from(height) / 2.0)
    }

    /// The same view with `width × height` pixels.
    pub fn resized(&self, width: u32, height: u32) -> Result<Self, PinholeError> {
        let (sx, sy) = (f64::from(width) / f64::from(self.width), f64::from(height) / f64::from(self.height));
        Self::new(width, height, self.fx * sx, self.fy * sy, self.cx * sx, self.cy * sy)
    }

    /// `u = fx x/z + cx`, `v = fy y/z + cy`; `None` unless `z > 0`.
    pub fn project(&self, p: &Point3<f64>) -> Option<(f64, f64)> {
        (p.z > 0.0).then(|| (self.fx * p.x / p.z + self.cx, self.fy * p.y / p.z + self.cy))
    }

    /// Camera-frame point at `(u, v)` and planar depth `z`.
    pub fn unproject(&self, u: f64, v: f64, z: f64) -> Point3<f64> {
        Point3::new((u - self.cx) / self.fx * z, (v - self.cy) / self.fy * z, z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixty_degrees_at_640_is_554_pixels() {
        let p = Pinhole::from_horizontal_fov(640, 480, 60f64.to_radians()).unwrap();
        assert!((p.fx - 554.256).abs() < 1e-3);
        assert_eq!((p.cx, p.cy), (320.0, 240.0));
    }

    #[test]
    fn resizing_keeps_the_viewing_ray() {
        let p = Pinhole::new(640, 480, 500.0, 510.0, 310.0, 250.0).unwrap();
        let half = p.resized(320, 240).unwrap();
        let x = Point3::new(0.3, -0.2, 1.7);
        let (u, v) = p.project(&x).unwrap();
        let (hu, hv) = half.project(&x).unwrap();
        assert!((u / 2.0 - hu).abs() < 1e-12 && (v / 2.0 - hv).abs() < 1e-12);
    }

    #[test]
    fn bad_intrinsics_are_named() {
        assert_eq!(
            Pinhole::new(640, 480, f64::NAN, 1.0, 0.0, 0.0).unwrap_err().to_string(),
            "fx must be finite and positive, found NaN"
        );
        assert!(Pinhole::new(0, 480, 1.0, 1.0, 0.0, 0.0).is_err());
    }
}
