//! The model: a set of anisotropic 3D Gaussians with view-dependent colour.

use crate::SplatError;
use crate::constants::{DC, OPACITY, PARAMETERS, POSITION, ROTATION, SCALE, SH_C0};
use crate::nearest::mean_squared_distances;
use crate::table::Table;

/// Opacity of a Gaussian made from a point, as in the original.
const INITIAL_OPACITY: f32 = 0.1;
/// Squared distances between points are at least this, square metres, as in the original.
const SQUARED_DISTANCE_MIN: f32 = 1e-7;

/// A set of Gaussians. Each has 59 numbers, row numbers in [`crate::constants`]: position (metres,
/// world), natural logarithm of the scales, rotation quaternion (w first, any length), logit of
/// the opacity, and 16 spherical harmonics for each of three colours.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gaussians {
    pub(crate) table: Table,
}

impl Gaussians {
    /// Gaussians at points, initialised as in the original: isotropic, scale the root of the mean
    /// squared distance to the three nearest other points, opacity 0.1, colour constant.
    ///
    /// `xyz` in metres, `rgb` in [0, 1].
    ///
    /// # Errors
    /// If the lists differ in length, are empty, or hold a value that is not finite.
    pub fn from_points(xyz: &[[f32; 3]], rgb: &[[f32; 3]]) -> Result<Self, SplatError> {
        if xyz.is_empty() {
            return Err(SplatError::Input("a map needs at least one point, found none".into()));
        }
        let mut gaussians = Self::default();
        gaussians.add_points(xyz, rgb)?;
        Ok(gaussians)
    }

    /// Appends Gaussians at points; the scale is taken from the nearest points and Gaussians.
    /// Initialisation and errors as in [`Self::from_points`], but no points are fine.
    pub fn add_points(&mut self, xyz: &[[f32; 3]], rgb: &[[f32; 3]]) -> Result<(), SplatError> {
        if xyz.len() != rgb.len() {
            return Err(SplatError::Input(format!("found {} points but {} colours", xyz.len(), rgb.len())));
        }
        for (name, list) in [("xyz", xyz), ("rgb", rgb)] {
            if let Some(i) = list.iter().position(|p| !p.iter().all(|v| v.is_finite())) {
                return Err(SplatError::Input(format!("{name} must be finite, found {:?} at index {i}", list[i])));
            }
        }
        let before = self.len();
        let mut all: Vec<[f32; 3]> = (0..before).map(|i| self.table.rows(i, POSITION)).collect();
        all.extend_from_slice(xyz);
        let squared = mean_squared_distances(&all, before);
        for ((p, c), d2) in xyz.iter().zip(rgb).zip(squared) {
            self.table.push(&point_parameters(*p, *c, d2));
        }
        Ok(())
    }

    /// From 59 numbers for each Gaussian.
    pub fn from_vectors(vectors: &[[f32; PARAMETERS]]) -> Self {
        let mut table = Table::default();
        for v in vectors {
            table.push(v);
        }
        Self { table }
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.table.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.table.is_empty()
    }

    /// The 59 numbers of Gaussian `i`.
    ///
    /// # Panics
    /// If there is no such Gaussian.
    pub fn vector(&self, i: usize) -> [f32; PARAMETERS] {
        self.table.vector(i)
    }

    /// Sets one of the 59 numbers of Gaussian `i`.
    ///
    /// # Panics
    /// If there is no such Gaussian or row.
    pub fn set(&mut self, i: usize, row: usize, value: f32) {
        self.table.set(i, row, value);
    }

    /// The numbers as they are stored.
    pub fn table(&self) -> &Table {
        &self.table
    }

    /// Position, metres.
    pub fn position(&self, i: usize) -> [f32; 3] {
        self.table.rows(i, POSITION)
    }

    /// Standard deviations along the Gaussian's own axes, metres.
    pub fn scale(&self, i: usize) -> [f32; 3] {
        self.table.rows(i, SCALE).map(f32::exp)
    }

    /// Opacity in [0, 1].
    pub fn opacity(&self, i: usize) -> f32 {
        1.0 / (1.0 + (-self.table.get(i, OPACITY)).exp())
    }
}

/// Inverse of the logistic function.
pub(crate) fn logit(p: f32) -> f32 {
    (p / (1.0 - p)).ln()
}

fn point_parameters(xyz: [f32; 3], rgb: [f32; 3], squared_distance: f32) -> [f32; PARAMETERS] {
    let mut v = [0.0; PARAMETERS];
    v[POSITION..POSITION + 3].copy_from_slice(&xyz);
    v[SCALE..SCALE + 3].fill(squared_distance.max(SQUARED_DISTANCE_MIN).sqrt().ln());
    v[ROTATION] = 1.0;
    v[OPACITY] = logit(INITIAL_OPACITY);
    for c in 0..3 {
        v[DC + c] = (rgb[c] - 0.5) / SH_C0;
    }
    v
}
