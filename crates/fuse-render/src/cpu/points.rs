//! Surface points seen through pixels, eight at a time: perspective-correct interpolation.

use fuse_camera::simd::F32x8;
use glam::{DVec3, Vec2, Vec3A};

use super::geometry::Geometry;
use super::lanes::{V3, less};
use super::transform::Setup;

/// Points of one group.
pub(super) const GROUP: usize = 8;

/// A triangle at a place of a pixel.
#[derive(Clone, Copy, Default)]
pub(super) struct Fragment {
    /// Index into the setups.
    pub setup: u32,
    /// Pixel of the image.
    pub x: u16,
    pub y: u16,
    /// Offset from the pixel's centre, pixels.
    pub dx: f32,
    pub dy: f32,
}

impl Fragment {
    fn at(&self) -> (f64, f64) {
        (f64::from(self.x) + 0.5 + f64::from(self.dx), f64::from(self.y) + 0.5 + f64::from(self.dy))
    }
}

/// Eight surface points, a list for each component.
#[derive(Clone, Default)]
pub(super) struct Points {
    pub position: [[f32; GROUP]; 3],
    /// Interpolated; of unit length and towards the viewer's side after [`Points::face`].
    pub normal: [[f32; GROUP]; 3],
    /// Unit normal of the triangle; towards the viewer's side after [`Points::face`].
    pub facet: [[f32; GROUP]; 3],
    /// Unit direction towards the eye, set by [`Points::face`].
    pub view: [[f32; GROUP]; 3],
    pub uv: [[f32; GROUP]; 2],
    /// Change of the texture coordinates from one pixel to the next along x.
    pub du: [[f32; GROUP]; 2],
    /// The same along y.
    pub dv: [[f32; GROUP]; 2],
    /// Index of their surface.
    pub surface: usize,
}

impl Points {
    /// Interpolates the triangles at the fragments, which are of one surface.
    #[inline(always)]
    pub fn fill<V: F32x8>(&mut self, geometry: &Geometry, setups: &[Setup], fragments: &[Fragment; GROUP]) {
        let first = &fragments[0];
        let part = geometry.triangle_part[setups[first.setup as usize].triangle as usize];
        self.surface = geometry.parts[part as usize].surface as usize;
        let mut other = 0;
        for fragment in fragments {
            other |= fragment.setup ^ first.setup;
        }
        if other == 0 {
            self.interpolate_one::<V>(geometry, &setups[first.setup as usize], fragments);
            return;
        }
        for (lane, fragment) in fragments.iter().enumerate() {
            self.interpolate(geometry, &setups[fragment.setup as usize], fragment.at(), lane);
        }
    }

    /// Turns normals towards the viewer's side: back faces of double-sided surfaces are lit like
    /// front faces.
    #[inline(always)]
    pub fn face<V: F32x8>(&mut self, eye: Vec3A) {
        let facet = V3::<V>::load(&self.facet);
        let to_eye = V3::splat(eye) - V3::load(&self.position);
        let normal = V3::load(&self.normal).normalize_or(facet);
        let side = V::splat(-1.0).select(less(facet.dot(to_eye), V::zero()), V::splat(1.0));
        let facet = facet.scale(side);
        normal.scale(side).store(&mut self.normal);
        facet.store(&mut self.facet);
        to_eye.normalize_or(facet).store(&mut self.view);
    }

    /// One triangle at all fragments.
    #[inline(always)]
    fn interpolate_one<V: F32x8>(&mut self, geometry: &Geometry, setup: &Setup, fragments: &[Fragment; GROUP]) {
        let triangle = setup.triangle as usize;
        let (u, v) = fragments[0].at();
        let at = DVec3::new(u, v, 1.0);
        let (mut x, mut y) = ([0.0; GROUP], [0.0; GROUP]);
        for (i, f) in fragments.iter().enumerate() {
            x[i] = f32::from(f.x) - f32::from(fragments[0].x) + (f.dx - fragments[0].dx);
            y[i] = f32::from(f.y) - f32::from(fragments[0].y) + (f.dy - fragments[0].dy);
        }
        let (x, y) = (V::load(&x), V::load(&y));
        // The common factor keeps single precision in range.
        let scale = 1.0 / (setup.edges[0].dot(at) + setup.edges[1].dot(at) + setup.edges[2].dot(at));
        let (mut e, mut total) = ([V::zero(); 3], V::zero());
        let (mut ex, mut ey) = ([0.0f32; 3], [0.0f32; 3]);
        for k in 0..3 {
            let edge = setup.edges[k];
            (ex[k], ey[k]) = ((edge.x * scale) as f32, (edge.y * scale) as f32);
            e[k] = V::splat((edge.dot(at) * scale) as f32) + V::splat(ex[k]) * x + V::splat(ey[k]) * y;
            total = total + e[k];
        }
        let (sx, sy) = (V::splat(ex[0] + ex[1] + ex[2]), V::splat(ey[0] + ey[1] + ey[2]));
        let inverse = V::splat(1.0) / total;
        let mut position = V3::all(V::zero());
        let mut normal = position;
        let (mut uv, mut du, mut dv) = ([V::zero(); 2], [V::zero(); 2], [V::zero(); 2]);
        for k in 0..3 {
            let vertex = &geometry.vertices[geometry.triangles[triangle][k] as usize];
            let b = e[k] * inverse;
            position = position + V3::splat(vertex.position.into()).scale(b);
            normal = normal + V3::splat(vertex.normal.into()).scale(b);
            let (bx, by) = ((V::splat(ex[k]) - b * sx) * inverse, (V::splat(ey[k]) - b * sy) * inverse);
            for c in 0..2 {
                let at = V::splat(vertex.uv[c]);
                uv[c] = uv[c] + at * b;
                du[c] = du[c] + at * bx;
                dv[c] = dv[c] + at * by;
            }
        }
        position.store(&mut self.position);
        normal.store(&mut self.normal);
        V3::<V>::splat(geometry.facets[triangle]).store(&mut self.facet);
        for c in 0..2 {
            uv[c].store(&mut self.uv[c]);
            du[c].store(&mut self.du[c]);
            dv[c].store(&mut self.dv[c]);
        }
    }

    #[inline(always)]
    fn interpolate(&mut self, geometry: &Geometry, setup: &Setup, (u, v): (f64, f64), lane: usize) {
        let triangle = setup.triangle as usize;
        let t = geometry.triangles[triangle];
        let at = DVec3::new(u, v, 1.0);
        let e = [setup.edges[0].dot(at), setup.edges[1].dot(at), setup.edges[2].dot(at)];
        let scale = 1.0 / (e[0] + e[1] + e[2]);
        // Barycentric coordinates, and their change along x and y.
        let (mut b, mut ex, mut ey) = ([0.0f32; 3], [0.0f32; 3], [0.0f32; 3]);
        for k in 0..3 {
            b[k] = (e[k] * scale) as f32;
            ex[k] = (setup.edges[k].x * scale) as f32;
            ey[k] = (setup.edges[k].y * scale) as f32;
        }
        let (sx, sy) = (ex[0] + ex[1] + ex[2], ey[0] + ey[1] + ey[2]);
        let (mut position, mut normal) = (Vec3A::ZERO, Vec3A::ZERO);
        let (mut uv, mut du, mut dv) = (Vec2::ZERO, Vec2::ZERO, Vec2::ZERO);
        for k in 0..3 {
            let vertex = &geometry.vertices[t[k] as usize];
            position += Vec3A::from(vertex.position) * b[k];
            normal += Vec3A::from(vertex.normal) * b[k];
            let at = vertex.uv;
            uv += at * b[k];
            du += at * (ex[k] - b[k] * sx);
            dv += at * (ey[k] - b[k] * sy);
        }
        let facet = geometry.facets[triangle];
        for k in 0..3 {
            self.position[k][lane] = position[k];
            self.normal[k][lane] = normal[k];
            self.facet[k][lane] = facet[k];
        }
        for k in 0..2 {
            self.uv[k][lane] = uv[k];
            self.du[k][lane] = du[k];
            self.dv[k][lane] = dv[k];
        }
    }
}
