//! Closed triangle surfaces: lofts between rings, texture coordinates, normals with a crease
//! angle.

use std::collections::HashMap;

use fuse_render::Mesh;
use glam::{Mat3, Vec2, Vec3};

/// A triangle with a texture coordinate per corner.
#[derive(Clone, Copy, Debug)]
pub struct Face {
    /// Indices into the surface's points.
    pub at: [u32; 3],
    /// Texture coordinates of the corners.
    pub uv: [Vec2; 3],
}

/// How a loft treats its first and last ring.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ends {
    /// Both are closed by a cap, unless they are a single point.
    Capped,
    /// The last ring joins the first: a torus-like surface.
    Joined,
}

/// A surface under construction; points are shared, so closedness is a matter of indices.
#[derive(Clone, Debug, Default)]
pub struct Surface {
    /// Points, metres.
    pub points: Vec<Vec3>,
    /// Triangles, counter-clockwise from outside.
    pub faces: Vec<Face>,
}

/// Running length along a polyline, as fractions of its whole; `closed` adds the last stretch.
fn fractions(points: &[Vec3], closed: bool) -> Vec<f32> {
    let mut at = vec![0.0f32];
    for i in 1..points.len() + usize::from(closed) {
        at.push(at[i - 1] + points[i - 1].distance(points[i % points.len()]));
    }
    let whole = at.last().copied().unwrap_or(1.0).max(1e-9);
    at.iter().map(|a| a / whole).collect()
}

impl Surface {
    /// The surface through closed rings of equally many points; a ring of one point is a pole.
    ///
    /// Texture coordinates: `u` the fraction of the way around, `v` of the way along. Winding
    /// is put right afterwards, so rings may run either way.
    pub fn loft(rings: &[Vec<Vec3>], ends: Ends) -> Self {
        let mut surface = Self::default();
        let starts: Vec<u32> = rings.iter().map(|ring| surface.append(ring)).collect();
        let sides = rings.iter().map(Vec::len).max().unwrap_or(0);
        let spine: Vec<Vec3> = (0..rings.len()).map(|i| rings[i].first().copied().unwrap_or_default()).collect();
        let along = fractions(&spine, ends == Ends::Joined);
        let around: Vec<Vec<f32>> = rings.iter().map(|ring| fractions(ring, true)).collect();
        let strips = if ends == Ends::Joined { rings.len() } else { rings.len().saturating_sub(1) };
        for i in 0..strips {
            let j = (i + 1) % rings.len();
            for k in 0..sides {
                let corner = |ring: usize, step: usize, v: f32| {
                    if rings[ring].len() == 1 {
                        (starts[ring], Vec2::new((k as f32 + 0.5) / sides as f32, v))
                    } else {
                        (starts[ring] + (step % sides) as u32, Vec2::new(around[ring][step], v))
                    }
                };
                let (a, b) = (corner(i, k, along[i]), corner(i, k + 1, along[i]));
                let (c, d) = (corner(j, k + 1, along[i + 1]), corner(j, k, along[i + 1]));
                surface.face([a, b, c]);
                surface.face([a, c, d]);
            }
        }
        if ends == Ends::Capped {
            surface.cap(&rings[0], starts[0], true, 0.0);
            surface.cap(&rings[rings.len() - 1], starts[rings.len() - 1], false, 1.0);
        }
        surface.outward()
    }

    fn append(&mut self, points: &[Vec3]) -> u32 {
        let start = self.points.len() as u32;
        self.points.extend_from_slice(points);
        start
    }

    /// Adds a triangle unless two of its corners coincide by index.
    fn face(&mut self, corners: [(u32, Vec2); 3]) {
        let at = corners.map(|c| c.0);
        if at[0] != at[1] && at[1] != at[2] && at[2] != at[0] {
            self.faces.push(Face { at, uv: corners.map(|c| c.1) });
        }
    }

    /// Closes a ring: by a fan where its centre sees every edge, by ear clipping otherwise.
    fn cap(&mut self, ring: &[Vec3], start: u32, first: bool, v: f32) {
        if ring.len() < 3 {
            return;
        }
        let n = ring.len();
        let centre = ring.iter().sum::<Vec3>() / n as f32;
        let normal = newell(ring);
        let star = (0..n).all(|k| (ring[k] - centre).cross(ring[(k + 1) % n] - centre).dot(normal) > 0.0);
        let uv = |k: usize| Vec2::new((k as f32 + 0.5) / n as f32, v);
        if star {
            let pole = self.append(&[centre]);
            for k in 0..n {
                let (a, b) = ((start + k as u32, uv(k)), (start + ((k + 1) % n) as u32, uv(k + 1)));
                self.face(if first { [b, a, (pole, uv(k))] } else { [a, b, (pole, uv(k))] });
            }
            return;
        }
        let (x, y) = normal.any_orthonormal_pair();
        let flat: Vec<Vec2> = ring.iter().map(|p| Vec2::new(p.dot(x), p.dot(y))).collect();
        for [a, b, c] in ear_clip(&flat) {
            let corner = |k: usize| (start + k as u32, uv(k));
            self.face(if first { [corner(c), corner(b), corner(a)] } else { [corner(a), corner(b), corner(c)] });
        }
    }

    /// Enclosed volume, cubic metres; negative when the winding points inwards.
    pub fn volume(&self) -> f32 {
        self.faces.iter().map(|f| f.at.map(|i| self.points[i as usize])).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
    }

    fn outward(mut self) -> Self {
        if self.volume() < 0.0 {
            for face in &mut self.faces {
                face.at.swap(1, 2);
                face.uv.swap(1, 2);
            }
        }
        self
    }

    /// Moves every point.
    #[must_use]
    pub fn map(mut self, f: impl Fn(Vec3) -> Vec3) -> Self {
        for p in &mut self.points {
            *p = f(*p);
        }
        self.outward()
    }

    /// Shifts by `by` metres.
    #[must_use]
    pub fn moved(self, by: Vec3) -> Self {
        self.map(|p| p + by)
    }

    /// Turns about the origin.
    #[must_use]
    pub fn turned(self, by: Mat3) -> Self {
        self.map(|p| by * p)
    }

    /// Changes every texture coordinate, knowing its point.
    #[must_use]
    pub fn map_uv(mut self, f: impl Fn(Vec3, Vec2) -> Vec2) -> Self {
        for face in &mut self.faces {
            for k in 0..3 {
                face.uv[k] = f(self.points[face.at[k] as usize], face.uv[k]);
            }
        }
        self
    }

    /// Projects the texture along each face's dominant axis, one tile per `tile` metres
    /// (`x` across the grain, `y` along it; the grain follows x, or z where x is the axis).
    #[must_use]
    pub fn uv_box(mut self, tile: Vec2) -> Self {
        for face in &mut self.faces {
            let p = face.at.map(|i| self.points[i as usize]);
            let n = (p[1] - p[0]).cross(p[2] - p[0]).abs();
            for (uv, q) in face.uv.iter_mut().zip(p) {
                *uv = if n.z >= n.x && n.z >= n.y {
                    Vec2::new(q.y, q.x)
                } else if n.y >= n.x {
                    Vec2::new(q.z, q.x)
                } else {
                    Vec2::new(q.y, q.z)
                } / tile;
            }
        }
        self
    }

    /// Faces for which `pick(centroid, unit normal)` holds, and the others; points are shared.
    pub fn split(self, pick: impl Fn(Vec3, Vec3) -> bool) -> (Self, Self) {
        let (mut yes, mut no) = (Self { points: self.points.clone(), faces: vec![] }, Self::default());
        for face in &self.faces {
            let [a, b, c] = face.at.map(|i| self.points[i as usize]);
            let normal = (b - a).cross(c - a).normalize_or_zero();
            if pick((a + b + c) / 3.0, normal) { yes.faces.push(*face) } else { no.faces.push(*face) }
        }
        no.points = self.points;
        (yes, no)
    }

    /// The surface as a mesh: neighbouring faces share a smooth normal where they meet at less
    /// than `crease` degrees.
    pub fn mesh(&self, material: usize, crease: f32) -> Mesh {
        let limit = crease.to_radians().cos();
        let raw: Vec<Vec3> = self
            .faces
            .iter()
            .map(|f| f.at.map(|i| self.points[i as usize]))
            .map(|[a, b, c]| (b - a).cross(c - a))
            .collect();
        let unit: Vec<Vec3> = raw.iter().map(|n| n.normalize_or_zero()).collect();
        let mut around: Vec<Vec<u32>> = vec![vec![]; self.points.len()];
        for (i, face) in self.faces.iter().enumerate() {
            face.at.iter().for_each(|&p| around[p as usize].push(i as u32));
        }
        let mut mesh = Mesh { material, ..Mesh::default() };
        let mut seen: HashMap<(u32, [i32; 3], [u32; 2]), u32> = HashMap::new();
        for (i, face) in self.faces.iter().enumerate() {
            let mut triangle = [0u32; 3];
            for k in 0..3 {
                let near = &around[face.at[k] as usize];
                let smooth = |all: bool| -> Vec3 {
                    near.iter()
                        .filter(|&&j| all || unit[j as usize].dot(unit[i]) > limit)
                        .map(|&j| raw[j as usize])
                        .sum()
                };
                let sum = if unit[i] == Vec3::ZERO { smooth(true) } else { smooth(false) };
                let normal = sum.try_normalize().unwrap_or(if unit[i] == Vec3::ZERO { Vec3::Z } else { unit[i] });
                let key = (
                    face.at[k],
                    (normal * 500.0).round().as_ivec3().to_array(),
                    face.uv[k].to_array().map(f32::to_bits),
                );
                triangle[k] = *seen.entry(key).or_insert_with(|| {
                    mesh.positions.push(self.points[face.at[k] as usize]);
                    mesh.normals.push(normal);
                    mesh.uvs.push(face.uv[k]);
                    mesh.positions.len() as u32 - 1
                });
            }
            mesh.triangles.push(triangle);
        }
        mesh
    }
}

/// Area-weighted normal of a closed ring.
fn newell(ring: &[Vec3]) -> Vec3 {
    let n = ring.len();
    (0..n).map(|k| ring[k].cross(ring[(k + 1) % n])).sum::<Vec3>().normalize_or_zero()
}

/// Triangulates a simple polygon; the triangles wind as the polygon does.
fn ear_clip(polygon: &[Vec2]) -> Vec<[usize; 3]> {
    let area: f32 = (0..polygon.len()).map(|k| polygon[k].perp_dot(polygon[(k + 1) % polygon.len()])).sum();
    let turn =
        |a: usize, b: usize, c: usize| (polygon[b] - polygon[a]).perp_dot(polygon[c] - polygon[a]) * area.signum();
    let mut left: Vec<usize> = (0..polygon.len()).collect();
    let mut triangles = vec![];
    while left.len() > 3 {
        let n = left.len();
        let is_ear = |k: usize, strict: bool| {
            let (a, b, c) = (left[(k + n - 1) % n], left[k], left[(k + 1) % n]);
            let empty = left.iter().all(|&p| {
                [a, b, c].contains(&p) || !(turn(a, b, p) >= 0.0 && turn(b, c, p) >= 0.0 && turn(c, a, p) >= 0.0)
            });
            (turn(a, b, c) > 0.0 && empty) || !strict
        };
        // A polygon that touches itself may have no strict ear; any corner keeps the cap closed.
        let k = (0..n).find(|&k| is_ear(k, true)).or_else(|| (0..n).find(|&k| is_ear(k, false))).unwrap_or(0);
        triangles.push([left[(k + n - 1) % n], left[k], left[(k + 1) % n]]);
        left.remove(k);
    }
    if let [a, b, c] = left[..] {
        triangles.push([a, b, c]);
    }
    triangles
}
