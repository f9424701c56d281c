//! A model as a rigid body: its closed parts, convex pieces, mass, and cavity.
//!
//! The mathematics here and in the files beside it is that of the physics engine, whose functions
//! give the same bits on every machine; glam's own sines come from the system.

use std::collections::{HashMap, HashSet};

use fuse_render::Model;
use rapier3d::dynamics::MassProperties;
use rapier3d::geometry::{ConvexPolyhedron, SharedShape, TriMesh, TriMeshFlags};
use rapier3d::glamx::{DMat3, DVec3, Vec3};
use rapier3d::math::Pose;

use super::cavity::{self, Cavity};
use super::compound::{self, Hollow, Hull};
use super::piece::Piece;
use super::units::{PER_METRE, points_to_engine};
use crate::objects::finish::density;

/// Parts of a model that are treated one by one; smaller ones are taken together.
const PARTS: usize = 16;
/// Convex pieces of an open vessel, of one of the two largest parts of anything else, and of a small part.
const PIECES: [usize; 3] = [56, 10, 2];
/// Density of what encloses no volume of its own, kg/m³.
const OPEN_DENSITY: f64 = 500.0;
/// Distance of the points on the surface at which penetration is measured, metres, and of those at vertices.
const SAMPLE: [f32; 2] = [0.003, 0.0006];

/// A model that can be settled and checked; model axes, metres, kilograms.
pub struct Solid {
    /// Convex pieces, for the physics engine and in its units.
    pub compound: SharedShape,
    /// The pieces' number.
    pub pieces: usize,
    /// Mass, centre of mass and inertia of the parts at the density of their materials.
    pub mass: MassProperties,
    /// The closed parts themselves, oriented, for the judgement.
    pub parts: Vec<TriMesh>,
    /// Points on the surface about [`SAMPLE`] apart.
    pub samples: Vec<Vec3>,
    /// Least and largest coordinates.
    pub bounds: [Vec3; 2],
    /// Where it is hollow, if it is an open vessel.
    pub cavity: Option<Cavity>,
}

impl std::fmt::Debug for Solid {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Solid({} parts, {} pieces)", self.parts.len(), self.pieces)
    }
}

/// A triangle and the density of its material.
type Weighed = ([Vec3; 3], f64);

impl Solid {
    /// The solid of a model; `None` when it spans no volume.
    pub fn new(model: &Model) -> Option<Self> {
        let groups = parts(model);
        let parts: Vec<TriMesh> = groups.iter().filter_map(|g| trimesh(g)).collect();
        let points = || groups.iter().flatten().flat_map(|t| t.0);
        let bounds = [points().reduce(Vec3::min)?, points().reduce(Vec3::max)?];
        let samples = samples(groups.iter().flatten().map(|t| t.0));
        let cavity = cavity::find(&parts, &samples, bounds[0], bounds[1]);
        let mut hulls: Vec<Hull> = vec![];
        for (i, group) in groups.iter().enumerate() {
            let triangles: Vec<[Vec3; 3]> = group.iter().map(|t| t.0).collect();
            let hollow = cavity.and_then(|c| hollow(&triangles, &c));
            let most = PIECES[if hollow.is_some() { 0 } else { 1 + i / 2 }.min(2)];
            hulls.extend(compound::decompose(&triangles, hollow, most));
        }
        let filled: Vec<Weighed> = hulls.iter().flat_map(Hull::triangles).map(|t| (t, OPEN_DENSITY)).collect();
        let shapes: Vec<(Pose, SharedShape)> =
            hulls.iter().filter_map(polyhedron).map(|p| (Pose::identity(), SharedShape::new(Piece(p)))).collect();
        if shapes.is_empty() {
            return None;
        }
        let pieces = shapes.len();
        let compound = SharedShape::compound(shapes);
        // What is open, as a user's model may be, weighs as much as its pieces would, half full.
        let mass = mass(groups.iter().flatten()).or_else(|| mass(filled.iter()))?;
        Some(Self { pieces, compound, mass, parts, samples, bounds, cavity })
    }

    /// Vertices of every piece, model axes, metres.
    pub fn polyhedra(&self) -> impl Iterator<Item = Vec<Vec3>> {
        let pieces = self.compound.as_compound().map_or(&[][..], |c| c.shapes());
        let vertices = |piece: &Piece| piece.0.points().iter().map(|p| *p / PER_METRE).collect();
        pieces.iter().filter_map(|(_, s)| s.as_shape::<Piece>()).map(vertices)
    }

    /// Extent along the model's axes, metres.
    pub fn size(&self) -> Vec3 {
        self.bounds[1] - self.bounds[0]
    }
}

/// The engine's polyhedron of a hull, in its units. It refuses faces that fold by rounding; then its own hull of the
/// same points will do, or their box.
fn polyhedron(hull: &Hull) -> Option<ConvexPolyhedron> {
    let points = points_to_engine(&hull.points);
    let boxed = Hull::around(&hull.points);
    ConvexPolyhedron::from_convex_mesh(points.clone(), &hull.faces)
        .or_else(|| ConvexPolyhedron::from_convex_hull(&points))
        .or_else(|| ConvexPolyhedron::from_convex_mesh(points_to_engine(&boxed.points), &boxed.faces))
}

/// The cavity as one part sees it: only a part around its axis is hollow.
fn hollow(triangles: &[[Vec3; 3]], cavity: &Cavity) -> Option<Hollow> {
    let (low, high) =
        triangles.iter().flatten().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), p| (l.min(*p), h.max(*p)));
    let reach = cavity.radius * 0.8;
    let around = low.x < cavity.axis.x - reach
        && low.y < cavity.axis.y - reach
        && high.x > cavity.axis.x + reach
        && high.y > cavity.axis.y + reach
        && high.z > cavity.floor + 0.3 * (cavity.rim - cavity.floor);
    around.then(|| Hollow { floor: Vec3::new(cavity.axis.x, cavity.axis.y, cavity.floor) })
}

/// Triangles of a model by connected part, the largest parts first; what is beyond [`PARTS`] together.
fn parts(model: &Model) -> Vec<Vec<Weighed>> {
    let mut index: HashMap<[u32; 3], usize> = HashMap::new();
    let mut parent: Vec<usize> = vec![];
    let mut faces: Vec<(usize, Weighed)> = vec![];
    for mesh in &model.meshes {
        let weight = f64::from(density(model.materials.get(mesh.material).map_or("", |m| m.name.as_str())));
        for t in &mesh.triangles {
            let corners = t.map(|i| Vec3::from_array(mesh.positions[i as usize].to_array()));
            let ids = corners.map(|p| {
                let next = index.len();
                let id = *index.entry(p.to_array().map(|v| (v + 0.0).to_bits())).or_insert(next);
                if id == parent.len() {
                    parent.push(id);
                }
                id
            });
            for k in [1, 2] {
                let (a, b) = (root(&mut parent, ids[0]), root(&mut parent, ids[k]));
                parent[a.max(b)] = a.min(b);
            }
            faces.push((ids[0], (corners, weight)));
        }
    }
    let mut groups: Vec<(usize, Vec<Weighed>)> = vec![];
    let mut slot: HashMap<usize, usize> = HashMap::new();
    for (id, face) in faces {
        let r = root(&mut parent, id);
        let at = *slot.entry(r).or_insert_with(|| {
            groups.push((r, vec![]));
            groups.len() - 1
        });
        groups[at].1.push(face);
    }
    let extent = |g: &[Weighed]| {
        let (l, h) =
            g.iter().flat_map(|t| t.0).fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
        (h - l).length()
    };
    groups.sort_by(|a, b| extent(&b.1).total_cmp(&extent(&a.1)).then(a.0.cmp(&b.0)));
    let mut parts: Vec<Vec<Weighed>> = groups.into_iter().map(|g| g.1).collect();
    if parts.len() > PARTS {
        let rest = parts.split_off(PARTS - 1).into_iter().flatten().collect();
        parts.push(rest);
    }
    parts
}

fn root(parent: &mut [usize], mut i: usize) -> usize {
    while parent[i] != i {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    i
}

fn trimesh(part: &[Weighed]) -> Option<TriMesh> {
    let mut index: HashMap<[u32; 3], u32> = HashMap::new();
    let mut points = vec![];
    let mut faces = vec![];
    for (corners, _) in part {
        let f = corners.map(|p| {
            *index.entry(p.to_array().map(|v| (v + 0.0).to_bits())).or_insert_with(|| {
                points.push(p);
                points.len() as u32 - 1
            })
        });
        if f[0] != f[1] && f[1] != f[2] && f[0] != f[2] {
            faces.push(f);
        }
    }
    TriMesh::with_flags(points, faces, TriMeshFlags::ORIENTED).ok()
}

/// Mass properties of closed parts: sums over the tetrahedra between the origin and each triangle.
fn mass<'a>(triangles: impl Iterator<Item = &'a Weighed>) -> Option<MassProperties> {
    let (mut mass, mut moment, mut second) = (0.0f64, DVec3::ZERO, DMat3::ZERO);
    let outer = |p: DVec3, q: DVec3| DMat3::from_cols(p * q.x, p * q.y, p * q.z);
    for (corners, weight) in triangles {
        let [a, b, c] = corners.map(|p| p.as_dvec3());
        let m = weight * a.dot(b.cross(c)) / 6.0;
        let sum = a + b + c;
        mass += m;
        moment += sum * (m / 4.0);
        second += (outer(sum, sum) + outer(a, a) + outer(b, b) + outer(c, c)) * (m / 20.0);
    }
    if mass < 1e-6 {
        return None;
    }
    let centre = moment / mass;
    let central = second - outer(centre, centre) * mass;
    let trace = central.x_axis.x + central.y_axis.y + central.z_axis.z;
    let inertia = DMat3::IDENTITY * trace - central;
    Some(MassProperties::with_inertia_matrix(centre.as_vec3(), mass as f32, inertia.as_mat3()))
}

/// Vertices and points between them, one a cell of a grid of [`SAMPLE`].
fn samples(triangles: impl Iterator<Item = [Vec3; 3]> + Clone) -> Vec<Vec3> {
    let mut taken: [HashSet<[i32; 3]>; 2] = [HashSet::new(), HashSet::new()];
    let mut points = vec![];
    let mut take = |p: Vec3, kind: usize| {
        let cell = |kind: usize| (p / SAMPLE[kind]).to_array().map(|v| v.floor() as i32);
        if taken[kind].insert(cell(kind)) {
            taken[0].insert(cell(0));
            points.push(p);
        }
    };
    triangles.clone().flatten().for_each(|p| take(p, 1));
    for [a, b, c] in triangles {
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        let n = (longest / SAMPLE[0]).ceil().clamp(1.0, 200.0) as usize;
        // Thin triangles need few rows.
        let across = (b - a).cross(c - a).length() / longest.max(1e-9);
        let (p, q, r) = longest_first([a, b, c]);
        let rows = (across / SAMPLE[0]).ceil().clamp(1.0, 200.0) as usize;
        for j in 0..=rows {
            let t = j as f32 / rows as f32;
            let (from, to) = (p.lerp(r, t), q.lerp(r, t));
            let steps = ((1.0 - t) * n as f32).ceil().max(1.0) as usize;
            (0..=steps).for_each(|i| take(from.lerp(to, i as f32 / steps as f32), 0));
        }
    }
    points
}

/// The corners so that the side between the first two is the longest.
fn longest_first([a, b, c]: [Vec3; 3]) -> (Vec3, Vec3, Vec3) {
    let (ab, bc, ca) = (a.distance_squared(b), b.distance_squared(c), c.distance_squared(a));
    if ab >= bc && ab >= ca {
        (a, b, c)
    } else if bc >= ca {
        (b, c, a)
    } else {
        (c, a, b)
    }
}
