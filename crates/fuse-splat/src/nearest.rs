//! Mean squared distance to the three nearest other points, by a k-d tree.

/// Neighbours that are averaged.
const NEIGHBOURS: usize = 3;
/// Ranges up to this long are searched one by one.
const LEAF: usize = 16;

/// For each of `points[from..]`, the mean squared distance to its (at most) three nearest other
/// points among all `points`; 0 for a lone point.
pub(crate) fn mean_squared_distances(points: &[[f32; 3]], from: usize) -> Vec<f32> {
    let mut tree = Tree { points, order: (0..points.len() as u32).collect(), axes: vec![0; points.len()] };
    tree.arrange(0, points.len());
    (from..points.len())
        .map(|i| {
            let mut best = Best { index: i as u32, squared: [f32::INFINITY; NEIGHBOURS] };
            tree.search(0, points.len(), points[i], &mut best);
            let found = best.squared.iter().filter(|d| d.is_finite());
            let (sum, count) = found.fold((0.0, 0), |(s, n), d| (s + d, n + 1));
            if count == 0 { 0.0 } else { sum / count as f32 }
        })
        .collect()
}

/// An implicit tree: the median of a range is in its middle, what is below it along the axis
/// stored at the middle is to the left, what is above to the right.
struct Tree<'a> {
    points: &'a [[f32; 3]],
    order: Vec<u32>,
    axes: Vec<u8>,
}

impl Tree<'_> {
    fn arrange(&mut self, start: usize, end: usize) {
        if end - start <= LEAF {
            return;
        }
        let points = self.points;
        let axis = longest_axis(points, &self.order[start..end]);
        let middle = usize::midpoint(start, end);
        self.axes[middle] = axis as u8;
        self.order[start..end].select_nth_unstable_by(middle - start, |&a, &b| {
            points[a as usize][axis].total_cmp(&points[b as usize][axis]).then(a.cmp(&b))
        });
        self.arrange(start, middle);
        self.arrange(middle + 1, end);
    }

    fn search(&self, start: usize, end: usize, query: [f32; 3], best: &mut Best) {
        let squared = |i: u32| (0..3).map(|a| (self.points[i as usize][a] - query[a]).powi(2)).sum::<f32>();
        if end - start <= LEAF {
            for &i in &self.order[start..end] {
                best.offer(i, squared(i));
            }
            return;
        }
        let middle = usize::midpoint(start, end);
        let (pivot, axis) = (self.order[middle], self.axes[middle] as usize);
        best.offer(pivot, squared(pivot));
        let offset = query[axis] - self.points[pivot as usize][axis];
        let (left, right) = ((start, middle), (middle + 1, end));
        let (near, far) = if offset < 0.0 { (left, right) } else { (right, left) };
        self.search(near.0, near.1, query, best);
        if offset * offset <= best.squared[NEIGHBOURS - 1] {
            self.search(far.0, far.1, query, best);
        }
    }
}

/// The axis along which a range of points is longest.
fn longest_axis(points: &[[f32; 3]], range: &[u32]) -> usize {
    let mut low = [f32::INFINITY; 3];
    let mut high = [f32::NEG_INFINITY; 3];
    for &i in range {
        for a in 0..3 {
            low[a] = low[a].min(points[i as usize][a]);
            high[a] = high[a].max(points[i as usize][a]);
        }
    }
    (0..3).max_by(|&a, &b| (high[a] - low[a]).total_cmp(&(high[b] - low[b]))).unwrap_or(0)
}

struct Best {
    index: u32,
    squared: [f32; NEIGHBOURS],
}

impl Best {
    fn offer(&mut self, index: u32, squared: f32) {
        if index == self.index || squared >= self.squared[NEIGHBOURS - 1] {
            return;
        }
        let at = self.squared.partition_point(|&d| d <= squared);
        self.squared[at..].rotate_right(1);
        self.squared[at] = squared;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tree_finds_what_a_full_search_finds() {
        let mut state = 1u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        // Coordinates on a coarse grid, so that ties and duplicates occur.
        let points: Vec<[f32; 3]> = (0..700).map(|_| [0; 3].map(|_| (random() * 24.0).floor() / 8.0)).collect();
        let fast = mean_squared_distances(&points, 0);
        for (i, p) in points.iter().enumerate() {
            let mut all: Vec<f32> = (0..points.len())
                .filter(|&j| j != i)
                .map(|j| (0..3).map(|a| (points[j][a] - p[a]).powi(2)).sum())
                .collect();
            all.sort_by(f32::total_cmp);
            assert!((fast[i] - (all[0] + all[1] + all[2]) / 3.0).abs() < 1e-6);
        }
    }

    #[test]
    fn few_points_use_the_neighbours_there_are() {
        assert_eq!(mean_squared_distances(&[[0.0; 3]], 0), [0.0]);
        assert_eq!(mean_squared_distances(&[[0.0; 3], [2.0, 0.0, 0.0]], 0), [4.0, 4.0]);
    }
}
