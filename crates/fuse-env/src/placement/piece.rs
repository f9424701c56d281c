//! A convex piece whose broad faces touch all over.
//!
//! The engine takes the first four corners of a face as its contact points, wherever they lie: a mug
//! whose foot has forty corners would stand on one side of it and rock. This shape is a convex
//! polyhedron that offers four corners evenly around the face instead. All lengths are in the engine's units.

use rapier3d::geometry::{ConvexPolyhedron, Ray, RayCast, RayIntersection, Shape, ShapeType, TypedShape};
use rapier3d::glamx::Vec3;
use rapier3d::math::Pose;
use rapier3d::parry::bounding_volume::{Aabb, BoundingSphere};
use rapier3d::parry::mass_properties::MassProperties;
use rapier3d::parry::query::{PointProjection, PointQuery};
use rapier3d::parry::shape::{FeatureId, PackedFeatureId, PolygonalFeature, PolygonalFeatureMap, SupportMap};

use super::units::PER_METRE;

/// Corners that are ahead of others by less count as level.
const AHEAD: f32 = 2e-4 * PER_METRE;

/// A convex polyhedron with four well spread contact points a face.
#[derive(Clone)]
pub struct Piece(pub ConvexPolyhedron);

impl Piece {
    /// The four corners (or fewer) of a face that stand for it, the first being `first`.
    fn corners(&self, fid: usize, first: usize, out: &mut PolygonalFeature) {
        let face = &self.0.faces()[fid];
        let (start, n) = (face.first_vertex_or_edge as usize, face.num_vertices_or_edges as usize);
        let kept = n.min(4);
        for i in 0..kept {
            let at = start + (first + i * n / kept) % n;
            let vertex = self.0.vertices_adj_to_face()[at];
            out.vertices[i] = self.0.points()[vertex as usize];
            out.vids[i] = PackedFeatureId::vertex(vertex);
            out.eids[i] = PackedFeatureId::edge(self.0.edges_adj_to_face()[at]);
        }
        out.fid = PackedFeatureId::face(fid as u32);
        out.num_vertices = kept;
    }

    fn corner(&self, at: usize) -> Vec3 {
        self.0.points()[self.0.vertices_adj_to_face()[at] as usize]
    }

    /// The face that looks most along `dir` among those that have a corner farthest that way: on a
    /// sharp piece the face that looks most along it may lie far behind the tip.
    fn face_toward(&self, dir: Vec3) -> usize {
        let farthest = self.0.points().iter().map(|p| p.dot(dir)).fold(f32::MIN, f32::max);
        let mut best = (f32::MIN, 0);
        for (i, face) in self.0.faces().iter().enumerate() {
            let looks = face.normal.dot(dir);
            let corners = face.first_vertex_or_edge..face.first_vertex_or_edge + face.num_vertices_or_edges;
            if looks > best.0 && corners.into_iter().any(|k| self.corner(k as usize).dot(dir) > farthest - AHEAD) {
                best = (looks, i);
            }
        }
        best.1
    }
}

impl SupportMap for Piece {
    fn local_support_point(&self, dir: Vec3) -> Vec3 {
        self.0.local_support_point(dir)
    }
}

impl PolygonalFeatureMap for Piece {
    fn local_support_feature(&self, dir: Vec3, out: &mut PolygonalFeature) {
        let fid = self.face_toward(dir);
        let face = &self.0.faces()[fid];
        let (start, n) = (face.first_vertex_or_edge as usize, face.num_vertices_or_edges as usize);
        let ahead = |i: usize| self.corner(start + i).dot(dir);
        // Where the face is tilted, the corner that is farthest ahead must be among the four.
        let first = (0..n).fold(0, |best, i| if ahead(i) > ahead(best) + AHEAD { i } else { best });
        self.corners(fid, first, out);
    }

    fn is_convex_polyhedron(&self) -> bool {
        true
    }
}

impl RayCast for Piece {
    fn cast_local_ray_and_get_normal(&self, ray: &Ray, most: f32, solid: bool) -> Option<RayIntersection> {
        self.0.cast_local_ray_and_get_normal(ray, most, solid)
    }
}

impl PointQuery for Piece {
    fn project_local_point(&self, point: Vec3, solid: bool) -> PointProjection {
        self.0.project_local_point(point, solid)
    }

    fn project_local_point_and_get_feature(&self, point: Vec3) -> (PointProjection, FeatureId) {
        self.0.project_local_point_and_get_feature(point)
    }
}

impl Shape for Piece {
    fn compute_local_aabb(&self) -> Aabb {
        self.0.compute_local_aabb()
    }

    fn compute_local_bounding_sphere(&self) -> BoundingSphere {
        self.0.compute_local_bounding_sphere()
    }

    fn clone_dyn(&self) -> Box<dyn Shape> {
        Box::new(self.clone())
    }

    fn scale_dyn(&self, scale: Vec3, _subdivisions: u32) -> Option<Box<dyn Shape>> {
        Some(Box::new(Self(self.0.clone().scaled(scale)?)))
    }

    fn compute_aabb(&self, position: &Pose) -> Aabb {
        self.0.compute_aabb(position)
    }

    fn mass_properties(&self, density: f32) -> MassProperties {
        self.0.mass_properties(density)
    }

    fn shape_type(&self) -> ShapeType {
        ShapeType::Custom
    }

    fn as_typed_shape(&self) -> TypedShape<'_> {
        TypedShape::Custom(self)
    }

    fn ccd_thickness(&self) -> f32 {
        self.0.ccd_thickness()
    }

    fn ccd_angular_thickness(&self) -> f32 {
        self.0.ccd_angular_thickness()
    }

    fn is_convex(&self) -> bool {
        true
    }

    fn as_support_map(&self) -> Option<&dyn SupportMap> {
        Some(self)
    }

    fn as_polygonal_feature_map(&self) -> Option<(&dyn PolygonalFeatureMap, f32)> {
        Some((self, 0.0))
    }
}
