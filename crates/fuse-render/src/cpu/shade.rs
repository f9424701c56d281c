//! Metal-rough shading of one surface point.

use glam::{DVec3, Vec2, Vec3};

use super::geometry::{Geometry, Surface};
use super::occlusion::Occlusion;
use super::shadow::Shadow;
use super::transform::Setup;
use crate::Light;

/// What shading reads; made once for a scene.
pub(super) struct Shading {
    pub light: Light,
    pub shadow: Option<Shadow>,
    pub occlusion: Option<Occlusion>,
    pub encode: SrgbTable,
}

/// A surface point seen through a pixel.
struct Point<'a> {
    position: Vec3,
    /// Unit, towards the viewer's side.
    normal: Vec3,
    /// Of the triangle, towards the viewer's side.
    facet: Vec3,
    uv: Vec2,
    du: Vec2,
    dv: Vec2,
    surface: &'a Surface,
}

/// The point of a triangle at continuous image coordinates `(u, v)`, with the screen-space
/// derivatives of its texture coordinates.
fn point<'a>(geometry: &'a Geometry, setup: &Setup, u: f64, v: f64, eye: Vec3) -> Point<'a> {
    let pixel = DVec3::new(u, v, 1.0);
    let e = setup.edges.map(|row| row.dot(pixel));
    let sum = e[0] + e[1] + e[2];
    let gradient = setup.edges[0] + setup.edges[1] + setup.edges[2];
    let weight = e.map(|e| (e / sum) as f32);
    let slope = |axis: usize| -> [f32; 3] {
        std::array::from_fn(|i| ((setup.edges[i][axis] - e[i] / sum * gradient[axis]) / sum) as f32)
    };
    let (wu, wv) = (slope(0), slope(1));
    let t = geometry.triangles[setup.triangle as usize].map(|v| v as usize);
    let part = &geometry.parts[geometry.triangle_part[setup.triangle as usize] as usize];
    let mix = |w: [f32; 3]| geometry.uvs[t[0]] * w[0] + geometry.uvs[t[1]] * w[1] + geometry.uvs[t[2]] * w[2];
    let p = t.map(|v| geometry.positions[v]);
    let position = p[0] * weight[0] + p[1] * weight[1] + p[2] * weight[2];
    let to_eye = eye - position;
    let n = t.map(|v| geometry.normals[v]);
    let normal = n[0] * weight[0] + n[1] * weight[1] + n[2] * weight[2];
    let facet = (p[1] - p[0]).cross(p[2] - p[0]).normalize_or(Vec3::Z);
    // Back faces of double-sided surfaces are lit like front faces.
    let side = if facet.dot(to_eye) < 0.0 { -1.0 } else { 1.0 };
    Point {
        position,
        normal: normal.normalize_or(facet) * side,
        facet: facet * side,
        uv: mix(weight),
        du: mix(wu),
        dv: mix(wv),
        surface: &geometry.surfaces[part.surface as usize],
    }
}

impl Shading {
    pub fn new(light: &Light, shadow: Option<Shadow>, occlusion: Option<Occlusion>) -> Self {
        let mut light = light.clone();
        for soft_box in &mut light.soft_boxes {
            soft_box.direction = soft_box.direction.normalize_or(Vec3::Z);
        }
        Self { light, shadow, occlusion, encode: SrgbTable::new() }
    }

    /// Display-linear colour of a triangle at continuous image coordinates.
    pub fn color(&self, geometry: &Geometry, setup: &Setup, u: f64, v: f64, eye: Vec3) -> Vec3 {
        let p = point(geometry, setup, u, v, eye);
        let mut base = p.surface.base;
        if let Some(texture) = &p.surface.texture {
            base *= texture.sample(p.uv, p.du, p.dv);
        }
        let view = (eye - p.position).normalize_or(p.facet);
        self.display(self.reflected(&p, base, view))
    }

    /// Radiance towards the viewer.
    fn reflected(&self, p: &Point<'_>, base: Vec3, view: Vec3) -> Vec3 {
        let (metallic, roughness) = (p.surface.metallic, p.surface.roughness);
        let f0 = Vec3::splat(0.04).lerp(base, metallic);
        let diffuse = base * (1.0 - metallic);
        let nv = p.normal.dot(view).max(1e-3);
        let reflection = p.normal * (2.0 * p.normal.dot(view)) - view;
        let blocked = self.occlusion.as_ref().map(|o| o.at(p.position, p.normal, reflection));
        let (hidden, hidden_mirror) = blocked.unwrap_or_default();
        let ambient = diffuse * self.irradiance(p.normal) * (1.0 - hidden)
            + environment_brdf(f0, roughness, nv) * self.surroundings(reflection, roughness) * (1.0 - hidden_mirror);
        ambient + self.key(p, diffuse, f0, view, nv, roughness)
    }

    /// Light from the key lamp: Lambert and GGX, the lamp's size widening the highlight.
    fn key(&self, p: &Point<'_>, diffuse: Vec3, f0: Vec3, view: Vec3, nv: f32, roughness: f32) -> Vec3 {
        let to_light = self.light.position - p.position;
        let distance2 = to_light.length_squared().max(1e-4);
        let l = to_light / distance2.sqrt();
        let nl = p.normal.dot(l);
        if nl <= 0.0 || p.facet.dot(l) <= 0.0 {
            return Vec3::ZERO;
        }
        let visible = self.shadow.as_ref().map_or(1.0, |s| s.visibility(p.position, p.facet));
        if visible <= 0.0 {
            return Vec3::ZERO;
        }
        let h = (l + view).normalize_or(p.normal);
        let (nh, vh) = (p.normal.dot(h).clamp(0.0, 1.0), view.dot(h).clamp(0.0, 1.0));
        let alpha = roughness * roughness;
        let wide = (alpha + 0.5 * self.light.radius / distance2.sqrt()).min(1.0);
        let a2 = wide * wide;
        let d = nh * nh * (a2 - 1.0) + 1.0;
        // GGX times π, since `intensity` is over π.
        let distribution = a2 / (d * d).max(1e-8);
        let k = alpha * 0.5;
        let visibility = 0.25 / ((nl * (1.0 - k) + k) * (nv * (1.0 - k) + k));
        let f = (1.0 - vh) * (1.0 - vh);
        let fresnel = f0 + (Vec3::ONE - f0) * (f * f * (1.0 - vh));
        (diffuse + fresnel * (distribution * visibility)) * self.light.intensity * (visible * nl / distance2)
    }

    /// Ambient irradiance over π on a surface with this normal.
    fn irradiance(&self, n: Vec3) -> Vec3 {
        let mut sum = self.light.ground.lerp(self.light.sky, 0.5 + 0.5 * n.z);
        for b in &self.light.soft_boxes {
            // The patch's solid angle is 2π/s (1 - 1/(1 + 2s)) ≈ 2π/s; the cosine is wrapped.
            let c = (0.5 + 0.5 * n.dot(b.direction)).max(0.0);
            sum += b.color * (2.0 / (1.0 + b.sharpness) * c * c);
        }
        sum
    }

    /// Ambient radiance from a direction, blurred as a surface of this roughness sees it.
    fn surroundings(&self, d: Vec3, roughness: f32) -> Vec3 {
        let t = (0.5 + d.z / (0.3 + 1.7 * roughness)).clamp(0.0, 1.0);
        let mut sum = self.light.ground.lerp(self.light.sky, t * t * (3.0 - 2.0 * t));
        let a = roughness * roughness;
        for b in &self.light.soft_boxes {
            let s = b.sharpness / (1.0 + b.sharpness * a);
            let lobe = 1.0 / (1.0 + s * (1.0 - d.dot(b.direction)));
            sum += b.color * (lobe * lobe * (1.0 + s) / (1.0 + b.sharpness));
        }
        sum
    }

    /// Exposure and tone curve: neutral below 0.76, smooth shoulder above (Khronos PBR neutral,
    /// without its toe), in [0, 1].
    fn display(&self, radiance: Vec3) -> Vec3 {
        const START: f32 = 0.76;
        const DESATURATION: f32 = 0.15;
        let c = radiance * self.light.exposure;
        let peak = c.max_element();
        if peak < START {
            return c.max(Vec3::ZERO);
        }
        let d = 1.0 - START;
        let new_peak = 1.0 - d * d / (peak + d - START);
        let g = 1.0 - 1.0 / (DESATURATION * (peak - new_peak) + 1.0);
        (c * (new_peak / peak)).lerp(Vec3::splat(new_peak), g).clamp(Vec3::ZERO, Vec3::ONE)
    }

    /// Background radiance through the tone curve.
    pub fn background(&self, radiance: Vec3) -> Vec3 {
        self.display(radiance)
    }
}

/// Split-sum environment reflectance, analytic fit (Karis, "Physically based shading on
/// mobile", 2014).
fn environment_brdf(f0: Vec3, roughness: f32, nv: f32) -> Vec3 {
    let r = [-roughness + 1.0, -0.0275 * roughness + 0.0425, -0.572 * roughness + 1.04, 0.022 * roughness - 0.04];
    let (a, edge) = (r[0] * r[0], 1.0 - nv);
    // The fit's 2^(-9.28 nv) is replaced by (1 - nv)⁵: no library call, the same bits anywhere.
    let edge = edge * edge * edge * edge * edge;
    let a004 = a.min(edge) * r[0] + r[1];
    let (scale, bias) = (-1.04 * a004 + r[2], 1.04 * a004 + r[3]);
    f0 * scale + Vec3::splat(bias)
}

/// Linear [0, 1] to sRGB bytes.
pub(super) struct SrgbTable(Vec<u8>);

impl SrgbTable {
    const SIZE: usize = 1 << 14;

    pub fn new() -> Self {
        let byte = |i: usize| {
            let v = i as f64 / (Self::SIZE - 1) as f64;
            let s = if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
            (s * 255.0 + 0.5) as u8
        };
        Self((0..Self::SIZE).map(byte).collect())
    }

    pub fn encode(&self, c: Vec3) -> [u8; 3] {
        let c = c * (Self::SIZE - 1) as f32 + Vec3::splat(0.5);
        c.to_array().map(|v| self.0[(v as usize).min(Self::SIZE - 1)])
    }
}
