//! Where a camera is.

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

/// Camera-from-world rigid transform: `x_camera = rotation · x_world + translation` (COLMAP's
/// `cam_from_world`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Rotation world → camera.
    pub rotation: UnitQuaternion<f64>,
    /// Translation world → camera, metres.
    pub translation: Vector3<f64>,
}

impl Pose {
    /// From a rotation matrix that is already orthonormal.
    pub fn from_matrix(rotation: Matrix3<f64>, translation: Vector3<f64>) -> Self {
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        Self { rotation, translation }
    }

    /// A camera at `center` that looks along compass direction `yaw` (radians about world z from
    /// the x axis), tilted down by `pitch_down` (radians), horizon level.
    pub fn from_yaw_pitch(center: Point3<f64>, yaw: f64, pitch_down: f64) -> Self {
        let (sy, cy) = yaw.sin_cos();
        let (sp, cp) = pitch_down.sin_cos();
        let forward = Vector3::new(cy * cp, sy * cp, -sp);
        let right = Vector3::new(sy, -cy, 0.0);
        let down = forward.cross(&right);
        let r = Matrix3::from_rows(&[right.transpose(), down.transpose(), forward.transpose()]);
        Self::from_matrix(r, -(r * center.coords))
    }

    /// A camera at `eye` looking at `target`; the image's up direction is as close to world z as
    /// can be (to world y when looking straight down or up).
    pub fn look_at(eye: Point3<f64>, target: Point3<f64>) -> Self {
        let forward = (target - eye).normalize();
        let up = if forward.z.abs() > 1.0 - 1e-9 { Vector3::y() } else { Vector3::z() };
        let right = forward.cross(&up).normalize();
        let down = forward.cross(&right);
        let r = Matrix3::from_rows(&[right.transpose(), down.transpose(), forward.transpose()]);
        Self::from_matrix(r, -(r * eye.coords))
    }

    /// Camera centre in the world, metres.
    pub fn center(&self) -> Point3<f64> {
        Point3::from(-(self.rotation.inverse() * self.translation))
    }

    /// World → camera.
    pub fn to_camera(&self, world: &Point3<f64>) -> Point3<f64> {
        self.rotation * world + self.translation
    }

    /// Camera → world.
    pub fn to_world(&self, camera: &Point3<f64>) -> Point3<f64> {
        self.rotation.inverse() * (camera - self.translation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looking_along_x_puts_y_left_and_z_up() {
        let pose = Pose::from_yaw_pitch(Point3::new(1.0, 2.0, 3.0), 0.0, 0.0);
        let p = pose.to_camera(&Point3::new(4.0, 3.0, 5.0));
        // 3 m ahead, 1 m to the left (world y), 2 m up.
        assert!((p - Point3::new(-1.0, -2.0, 3.0)).norm() < 1e-12);
        assert!((pose.center() - Point3::new(1.0, 2.0, 3.0)).norm() < 1e-12);
        assert!((pose.to_world(&p) - Point3::new(4.0, 3.0, 5.0)).norm() < 1e-12);
    }

    #[test]
    fn look_at_agrees_with_yaw_and_pitch() {
        let eye = Point3::new(0.0, 0.0, 1.0);
        let a = Pose::look_at(eye, Point3::new(1.0, 1.0, 0.0));
        let b = Pose::from_yaw_pitch(eye, 45f64.to_radians(), (1.0 / 2f64.sqrt()).atan());
        assert!(a.rotation.angle_to(&b.rotation) < 1e-9);
        assert!((a.translation - b.translation).norm() < 1e-9);
    }

    #[test]
    fn straight_down_is_defined() {
        let p = Pose::look_at(Point3::new(0.0, 0.0, 2.0), Point3::origin());
        assert!((p.to_camera(&Point3::origin()) - Point3::new(0.0, 0.0, 2.0)).norm() < 1e-12);
    }
}
