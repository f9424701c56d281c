//! Convex hull of a point set, incremental, with exact predicates.

use std::collections::{BTreeSet, HashSet};

use glam::{DVec3, Vec3};

/// A convex polyhedron with triangular faces.
#[derive(Clone, Debug, Default)]
pub struct Hull {
    /// Vertices, metres; not every one need be used.
    pub points: Vec<DVec3>,
    /// Faces, counter-clockwise from outside.
    pub faces: Vec<[usize; 3]>,
}

/// A face while the hull grows.
#[derive(Clone, Copy)]
struct Facet {
    at: [usize; 3],
    /// Unscaled normal, and the largest error of its products with offsets of unit size.
    normal: DVec3,
    doubt: f64,
}

/// The vertices in units of [`GRID`], so that predicates can be exact.
struct Lattice(Vec<[i64; 3]>);

/// Points closer than this are one, metres.
const MERGE: f64 = 2e-5;
/// Unit of the lattice that the hull is computed on, metres.
const GRID: f64 = 1e-8;
/// Largest random shift of a point, in units of [`GRID`].
const JITTER: u64 = 100;

impl Hull {
    /// The hull of `points` (within 10 m of the origin); `None` when they do not span a volume.
    ///
    /// Points are moved by up to a micrometre, the same way every time, so that hardly any four
    /// lie in one plane; the rest is exact, so that nearly flat sides cannot go wrong.
    pub fn new(points: impl Iterator<Item = Vec3>) -> Option<Self> {
        let cells: BTreeSet<[i64; 3]> = points
            .filter(|p| p.is_finite() && p.abs().max_element() < 10.0)
            .map(|p| p.to_array().map(|v| (f64::from(v) / MERGE).round() as i64))
            .collect();
        let lattice: Vec<[i64; 3]> = cells
            .iter()
            .enumerate()
            .map(|(i, cell)| {
                std::array::from_fn(|k| {
                    let h = (i as u64 * 3 + k as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
                    let h = (h ^ (h >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
                    cell[k] * (MERGE / GRID) as i64 + ((h >> 33) % (2 * JITTER + 1)) as i64 - JITTER as i64
                })
            })
            .collect();
        let points: Vec<DVec3> = lattice.iter().map(|p| DVec3::from_array(p.map(|v| v as f64 * GRID))).collect();
        let lattice = Lattice(lattice);
        let mut facets: Vec<Facet> = tetrahedron(&points)?.into_iter().map(|at| lattice.facet(at)).collect();
        for i in 0..points.len() {
            lattice.add(&mut facets, i);
        }
        Some(Self { points, faces: facets.iter().map(|f| f.at).collect() })
    }

    /// Unit normal and area of a face.
    pub fn plane(&self, face: [usize; 3]) -> (DVec3, f64) {
        let [a, b, c] = face.map(|i| self.points[i]);
        let n = (b - a).cross(c - a);
        (n.normalize_or_zero(), n.length() / 2.0)
    }
}

impl Lattice {
    fn offset(&self, from: usize, to: usize) -> [i64; 3] {
        std::array::from_fn(|k| self.0[to][k] - self.0[from][k])
    }

    fn facet(&self, at: [usize; 3]) -> Facet {
        let [u, v] = [at[1], at[2]].map(|i| DVec3::from_array(self.offset(at[0], i).map(|x| x as f64)));
        Facet { at, normal: u.cross(v), doubt: 1e-14 * u.abs().max_element() * v.abs().max_element() }
    }

    /// Whether a point lies strictly outside of a face: the sign of a determinant, in floating
    /// point where that is certain, else in integers.
    fn outside(&self, face: &Facet, point: usize) -> bool {
        let w = self.offset(face.at[0], point);
        let fw = DVec3::from_array(w.map(|x| x as f64));
        let rough = face.normal.dot(fw);
        if rough.abs() > face.doubt * fw.abs().max_element() {
            return rough > 0.0;
        }
        let [u, v, w] =
            [self.offset(face.at[0], face.at[1]), self.offset(face.at[0], face.at[2]), w].map(|q| q.map(i128::from));
        let exact = (u[1] * v[2] - u[2] * v[1]) * w[0]
            + (u[2] * v[0] - u[0] * v[2]) * w[1]
            + (u[0] * v[1] - u[1] * v[0]) * w[2];
        exact > 0
    }

    /// Replaces the faces that see a point by a fan from their horizon to it.
    fn add(&self, facets: &mut Vec<Facet>, point: usize) {
        let mut seen = vec![];
        facets.retain(|f| {
            let out = self.outside(f, point);
            if out {
                seen.push(f.at);
            }
            !out
        });
        let edges: HashSet<(usize, usize)> = seen.iter().flat_map(|&f| sides(f)).collect();
        for (a, b) in seen.iter().flat_map(|&f| sides(f)) {
            if !edges.contains(&(b, a)) {
                facets.push(self.facet([a, b, point]));
            }
        }
    }
}

/// The directed edges of a face.
pub fn sides(f: [usize; 3]) -> [(usize, usize); 3] {
    [(f[0], f[1]), (f[1], f[2]), (f[2], f[0])]
}

/// Four faces around far apart points.
fn tetrahedron(points: &[DVec3]) -> Option<Vec<[usize; 3]>> {
    let farthest = |score: &dyn Fn(DVec3) -> f64| {
        (0..points.len())
            .max_by(|&i, &j| score(points[i]).total_cmp(&score(points[j])))
            .filter(|&i| score(points[i]) > 1e-5)
    };
    let a = 0;
    let origin = *points.first()?;
    let b = farthest(&|p| p.distance(origin))?;
    let axis = (points[b] - origin).normalize();
    let c = farthest(&|p| (p - origin).reject_from_normalized(axis).length())?;
    let normal = (points[b] - origin).cross(points[c] - origin).normalize();
    let d = farthest(&|p| (p - origin).dot(normal).abs())?;
    let faces = [[a, b, c], [a, d, b], [b, d, c], [c, d, a]];
    let above = (points[d] - origin).dot(normal) > 0.0;
    Some(faces.map(|[i, j, k]| if above { [i, k, j] } else { [i, j, k] }).to_vec())
}
