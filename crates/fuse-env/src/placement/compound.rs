//! Convex decomposition of a closed mesh: planes cut it into pieces whose convex hulls fill little
//! more than they hold, so that a vessel stays hollow.
//!
//! Every piece's hull contains its part of the mesh up to [`TOLERANCE`], so that two models whose
//! hulls do not touch do not touch either. Where a cut goes is decided by the volume of the hulls on
//! both sides; what a piece itself holds is an integral over its triangles and the caps of its cuts.

use rapier3d::glamx::{DVec3, Quat, Vec3};
use rapier3d::parry::transformation::try_convex_hull;

/// How far a vertex may lie outside of the simplified hull of its piece, metres.
pub const TOLERANCE: f32 = 3e-4;
/// A piece whose hull holds so little more than itself, in metres over half its hull's surface, is left whole.
const GOOD: f64 = 4e-4;
/// What a cut into unequal parts costs: where none gains anything, a ring must still be halved.
const UNEVEN: f64 = 0.02;
/// Empty volume that is worth a cut, m³.
const WORTH: f64 = 1e-7;

/// Directions in which hulls are judged: the corners, edges and faces of a cube and what lies between.
fn directions() -> Vec<Vec3> {
    let steps = [-2.0f32, -1.0, 0.0, 1.0, 2.0];
    let mut all = vec![];
    for x in steps {
        for y in steps {
            for z in steps {
                if x.abs().max(y.abs()).max(z.abs()) == 2.0 {
                    all.push(Vec3::new(x, y, z).normalize());
                }
            }
        }
    }
    all
}

/// A closed triangle hull.
#[derive(Clone, Debug)]
pub struct Hull {
    /// Vertices, metres.
    pub points: Vec<Vec3>,
    /// Faces, counter-clockwise from outside.
    pub faces: Vec<[u32; 3]>,
}

impl Hull {
    /// The hull of `points`; `None` when they do not span a volume.
    fn of(points: &[Vec3]) -> Option<Self> {
        let (points, faces) = try_convex_hull(points).ok()?;
        (faces.len() >= 4).then_some(Self { points, faces })
    }

    /// The hull of the points that are farthest in some directions, and then of those that stick out
    /// of it by more than [`TOLERANCE`].
    fn simplified(points: &[Vec3], directions: &[Vec3]) -> Option<Self> {
        let mut kept = extreme(points, directions);
        for _ in 0..12 {
            let hull = Self::of(&kept)?;
            let before = kept.len();
            for f in &hull.faces {
                let [a, b, c] = f.map(|i| hull.points[i as usize]);
                let normal = (b - a).cross(c - a).normalize_or_zero();
                let farthest = points.iter().copied().max_by(|p, q| normal.dot(*p).total_cmp(&normal.dot(*q)))?;
                if normal.dot(farthest - a) > TOLERANCE && !kept.contains(&farthest) {
                    kept.push(farthest);
                }
            }
            if kept.len() == before {
                return Some(hull);
            }
        }
        Self::of(points)
    }

    /// The box around some points, at least a few tenths of a millimetre thick: for what no hull is found of.
    pub fn around(points: &[Vec3]) -> Self {
        let low = points.iter().copied().reduce(Vec3::min).unwrap_or_default();
        let high = points.iter().copied().reduce(Vec3::max).unwrap_or_default();
        let (middle, half) = ((low + high) / 2.0, ((high - low) / 2.0).max(Vec3::splat(2e-4)));
        let sign = |bit: u32| if bit == 0 { -1.0 } else { 1.0 };
        let points = (0..8u32).map(|i| middle + half * Vec3::new(sign(i & 1), sign(i & 2), sign(i & 4))).collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let faces = quads.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        Self { points, faces }
    }

    /// Corners of every face.
    pub fn triangles(&self) -> impl Iterator<Item = [Vec3; 3]> {
        self.faces.iter().map(|f| f.map(|i| self.points[i as usize]))
    }

    /// Volume in m³ and surface in m².
    pub fn measure(&self) -> (f64, f64) {
        let Some(origin) = self.points.first().map(|p| p.as_dvec3()) else { return (0.0, 0.0) };
        self.faces.iter().fold((0.0, 0.0), |(volume, area), f| {
            let [a, b, c] = f.map(|i| self.points[i as usize].as_dvec3() - origin);
            (volume + a.dot(b.cross(c)) / 6.0, area + (b - a).cross(c - a).length() / 2.0)
        })
    }
}

/// The points that are farthest in one of the directions.
fn extreme(points: &[Vec3], directions: &[Vec3]) -> Vec<Vec3> {
    let mut at: Vec<usize> = directions
        .iter()
        .filter_map(|d| (0..points.len()).max_by(|&i, &j| d.dot(points[i]).total_cmp(&d.dot(points[j]))))
        .collect();
    at.sort_unstable();
    at.dedup();
    at.into_iter().map(|i| points[i]).collect()
}

/// A plane `normal · p = offset`.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    normal: Vec3,
    offset: f32,
}

impl Plane {
    /// The plane through a point.
    pub fn new(normal: Vec3, through: Vec3) -> Self {
        Self { normal, offset: normal.dot(through) }
    }

    fn side(&self, p: Vec3) -> f32 {
        self.normal.dot(p) - self.offset
    }
}

/// A part of a closed mesh between cuts.
struct Piece {
    /// What is left of the mesh.
    skin: Vec<[Vec3; 3]>,
    /// Caps of the cuts as fans, which may overlap: their signed areas add up to the cap.
    caps: Vec<[Vec3; 3]>,
    /// Volume of the hull that is not in the piece, m³.
    empty: f64,
    /// Whether cutting is of no use.
    done: bool,
}

impl Piece {
    fn new(skin: Vec<[Vec3; 3]>, caps: Vec<[Vec3; 3]>, directions: &[Vec3]) -> Self {
        let mut piece = Self { skin, caps, empty: 0.0, done: true };
        if let Some(hull) = Hull::of(&extreme(&piece.points(), directions)) {
            let (volume, area) = hull.measure();
            piece.empty = volume - piece.volume();
            piece.done = piece.empty < WORTH || piece.empty < GOOD * area / 2.0;
        }
        piece
    }

    fn points(&self) -> Vec<Vec3> {
        let mut points: Vec<Vec3> = self.skin.iter().flatten().copied().collect();
        points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)).then(a.z.total_cmp(&b.z)));
        points.dedup();
        points
    }

    fn volume(&self) -> f64 {
        let origin = self.skin.first().map_or(DVec3::ZERO, |t| t[0].as_dvec3());
        let part = |[a, b, c]: [DVec3; 3]| a.dot(b.cross(c)) / 6.0;
        self.skin.iter().chain(&self.caps).map(|t| part(t.map(|p| p.as_dvec3() - origin))).sum()
    }

    /// The two sides of a plane, the one below first; `None` when one is empty.
    fn cut(&self, plane: &Plane, directions: &[Vec3]) -> Option<[Self; 2]> {
        let mut sides = [(vec![], vec![]), (vec![], vec![])];
        for (k, (skin, caps)) in sides.iter_mut().enumerate() {
            let keep = if k == 0 { -1.0 } else { 1.0 };
            let mut rim = vec![];
            self.skin.iter().for_each(|t| clip(*t, plane, keep, skin, &mut rim));
            self.caps.iter().for_each(|t| clip(*t, plane, keep, caps, &mut rim));
            let Some(apex) = rim.first().map(|e: &[Vec3; 2]| e[0]) else { continue };
            caps.extend(rim.iter().map(|[a, b]| [apex, *b, *a]));
        }
        if sides.iter().any(|s| s.0.is_empty()) {
            return None;
        }
        Some(sides.map(|(skin, caps)| Self::new(skin, caps, directions)))
    }
}

/// Adds what is left of a triangle on one side of a plane to `kept`, and the edge along the plane to `rim`.
fn clip(t: [Vec3; 3], plane: &Plane, keep: f32, kept: &mut Vec<[Vec3; 3]>, rim: &mut Vec<[Vec3; 2]>) {
    // A point in the plane counts as above it for both sides.
    let above = t.map(|p| plane.side(p) >= 0.0);
    let inside = above.map(|a| a == (keep > 0.0));
    let mut corners: Vec<Vec3> = Vec::with_capacity(4);
    let (mut leaves, mut enters) = (None, None);
    for i in 0..3 {
        let j = (i + 1) % 3;
        if inside[i] {
            corners.push(t[i]);
        }
        if inside[i] != inside[j] {
            let crossing = cross(plane, t[i], t[j]);
            corners.push(crossing);
            *(if inside[i] { &mut leaves } else { &mut enters }) = Some(crossing);
        }
    }
    for i in 2..corners.len() {
        kept.push([corners[0], corners[i - 1], corners[i]]);
    }
    if let (Some(a), Some(b)) = (leaves, enters) {
        rim.push([a, b]);
    }
}

/// Where a plane meets the edge between two points, the same from both ends.
fn cross(plane: &Plane, a: Vec3, b: Vec3) -> Vec3 {
    let (a, b) = if a.to_array() < b.to_array() { (a, b) } else { (b, a) };
    let (da, db) = (plane.side(a), plane.side(b));
    a + (b - a) * (da / (da - db)).clamp(0.0, 1.0)
}

/// The plane that leaves the least hull on both sides of a piece, among those across its extent and
/// those through the axis at `middle`.
fn best_cut(piece: &Piece, middle: Vec3, directions: &[Vec3]) -> Option<Plane> {
    let points = piece.points();
    let low = points.iter().copied().reduce(Vec3::min)?;
    let high = points.iter().copied().reduce(Vec3::max)?;
    // Off the even fractions, where models have rings of vertices.
    let across = [0.263, 0.501, 0.743]
        .into_iter()
        .flat_map(|f| [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| Plane::new(axis, low + (high - low) * f)));
    let whole = volume(&points, directions);
    across
        .chain(radial().into_iter().map(|normal| Plane::new(normal, middle)))
        .filter_map(|plane| {
            let [below, over] = split(piece, &plane, directions)?;
            Some((below + over + UNEVEN * (below - over).abs() / whole.max(1e-12) * whole, plane))
        })
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|best| best.1)
}

/// Hull volumes on both sides of a plane; `None` when one side is empty.
fn split(piece: &Piece, plane: &Plane, directions: &[Vec3]) -> Option<[f64; 2]> {
    let (mut below, mut over) = (vec![], vec![]);
    for t in &piece.skin {
        for i in 0..3 {
            let (p, q) = (t[i], t[(i + 1) % 3]);
            let (up, next) = (plane.side(p) >= 0.0, plane.side(q) >= 0.0);
            if up {
                over.push(p)
            } else {
                below.push(p)
            }
            if up != next {
                let c = cross(plane, p, q);
                over.push(c);
                below.push(c);
            }
        }
    }
    if below.is_empty() || over.is_empty() {
        return None;
    }
    Some([volume(&below, directions), volume(&over, directions)])
}

fn volume(points: &[Vec3], directions: &[Vec3]) -> f64 {
    Hull::of(&extreme(points, directions)).map_or(0.0, |h| h.measure().0)
}

/// Normals of eight planes through a vertical axis, evenly around; a little off the models' own vertices.
fn radial() -> [Vec3; 8] {
    std::array::from_fn(|i| Quat::from_rotation_z((i as f32 + 0.013) * std::f32::consts::PI / 8.0) * Vec3::X)
}

/// Where a vessel is hollow: cuts that are made before any other.
#[derive(Clone, Copy, Debug)]
pub struct Hollow {
    /// A point of the axis at the height of the floor inside, metres.
    pub floor: Vec3,
}

/// Convex pieces of a closed part, at most about `most` of them.
pub fn decompose(triangles: &[[Vec3; 3]], hollow: Option<Hollow>, most: usize) -> Vec<Hull> {
    let directions = directions();
    let mut pieces = vec![Piece::new(triangles.to_vec(), vec![], &directions)];
    let points = pieces[0].points();
    let low = points.iter().copied().reduce(Vec3::min).unwrap_or_default();
    let high = points.iter().copied().reduce(Vec3::max).unwrap_or_default();
    let mut middle = (low + high) / 2.0;
    if let Some(Hollow { floor }) = hollow {
        middle = Vec3::new(floor.x, floor.y, middle.z);
        pieces = slice(pieces, &Plane::new(Vec3::Z, floor + Vec3::Z * 4e-4), 1, &directions);
        for normal in radial() {
            pieces = slice(pieces, &Plane::new(normal, middle), 0, &directions);
        }
    }
    while pieces.len() < most {
        let worst =
            (0..pieces.len()).filter(|&i| !pieces[i].done).max_by(|&i, &j| pieces[i].empty.total_cmp(&pieces[j].empty));
        let Some(i) = worst else { break };
        match best_cut(&pieces[i], middle, &directions).and_then(|plane| pieces[i].cut(&plane, &directions)) {
            Some([below, over]) => {
                pieces[i] = below;
                pieces.push(over);
            }
            None => pieces[i].done = true,
        }
    }
    pieces
        .iter()
        .map(|p| {
            let points = p.points();
            Hull::simplified(&points, &directions).unwrap_or_else(|| Hull::around(&points))
        })
        .collect()
}

/// Cuts every piece that is not good as it is by a plane; with `first` 1, the floor is not cut again.
fn slice(pieces: Vec<Piece>, plane: &Plane, first: usize, directions: &[Vec3]) -> Vec<Piece> {
    let mut out = vec![];
    for piece in pieces {
        match (piece.done, piece.cut(plane, directions)) {
            (false, Some([mut below, over])) => {
                below.done |= first == 1;
                out.extend([below, over]);
            }
            _ => out.push(piece),
        }
    }
    out
}
