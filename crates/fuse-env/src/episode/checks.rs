//! What makes an episode sound: by itself, and against the statistics of its targets.

use glam::Quat;

use super::{DISTRACTORS, Episode, EpisodeError, GOOD_FRACTION, GOOD_PX, MOST_MOVES, START_FRACTION};
use crate::catalogue::Catalogue;
use crate::configuration::SceneConfiguration;
use crate::targets::{TargetStatistics, good_view};

/// Bytes of a query that the Gymnasium environment has room for.
const LONGEST_QUERY: usize = 200;

impl Episode {
    /// Checks that the episode is complete and fits the catalogue and the scenes.
    pub fn validate(&self, catalogue: &Catalogue, scenes: &[SceneConfiguration]) -> Result<(), EpisodeError> {
        self.check_world(catalogue, scenes)
            .and_then(|()| self.check_ids())
            .and_then(|()| self.check_start())
            .map_err(|reason| EpisodeError::Invalid { episode: self.episode_id.clone(), reason })
    }

    fn check_world(&self, catalogue: &Catalogue, scenes: &[SceneConfiguration]) -> Result<(), String> {
        let scene = crate::configuration::find(scenes, &self.scene_id).map_err(|e| e.to_string())?;
        if scene.split != self.split {
            return Err(format!("split {} in scene `{}` of split {}", self.split, scene.name, scene.split));
        }
        for object in &self.objects {
            let id = &object.model_id;
            let record = catalogue.get(id).ok_or_else(|| format!("unknown object `{id}`"))?;
            if record.category != object.category {
                return Err(format!("object `{id}` is a {}, found category {}", record.category, object.category));
            }
            if record.split != self.split {
                return Err(format!("object `{id}` belongs to split {}, expected {}", record.split, self.split));
            }
            let q = object.rotation;
            let norm = Quat::from_xyzw(q.x, q.y, q.z, q.w).length();
            if !object.translation.iter().all(|v| v.is_finite()) || !(0.999..=1.001).contains(&norm) {
                return Err(format!("object `{id}` has no finite position or no unit rotation"));
            }
        }
        Ok(())
    }

    fn check_ids(&self) -> Result<(), String> {
        let mut ids: Vec<u32> = self.objects.iter().map(|o| o.instance_id).collect();
        ids.sort_unstable();
        if ids.first() == Some(&0) || ids.windows(2).any(|w| w[0] == w[1]) {
            return Err("instance ids must be unique and not 0".into());
        }
        if ids.binary_search(&self.target).is_err() {
            return Err(format!("target {} is not among the objects", self.target));
        }
        if self.valid_target_ids.first() != Some(&self.target) {
            return Err(format!("valid_target_ids must begin with the target {}", self.target));
        }
        if let Some(id) = self.valid_target_ids.iter().find(|id| ids.binary_search(id).is_err()) {
            return Err(format!("valid target {id} is not among the objects"));
        }
        let mut others = self.distractor_ids.clone();
        others.sort_unstable();
        ids.retain(|id| *id != self.target);
        if others != ids {
            return Err("distractor_ids must name every object but the target".into());
        }
        let [fewest, most] = DISTRACTORS;
        if !(fewest..=most).contains(&(others.len() as u32)) {
            return Err(format!("{} distractors, expected {fewest} to {most}", others.len()));
        }
        Ok(())
    }

    fn check_start(&self) -> Result<(), String> {
        self.start().map_err(|e| format!("start: {e}"))?;
        self.best().map_err(|e| format!("best view: {e}"))?;
        if self.query.is_empty() || self.query.len() > LONGEST_QUERY {
            return Err(format!("query must have 1 to {LONGEST_QUERY} bytes, found {}", self.query.len()));
        }
        let fraction = self.start_fraction;
        if !(START_FRACTION[0]..=START_FRACTION[1]).contains(&fraction) {
            return Err(format!("the start view shows {fraction:.3} of the target, expected {START_FRACTION:?}"));
        }
        let good = (GOOD_FRACTION..=1.0).contains(&self.best_fraction) && self.best_px >= GOOD_PX;
        if !good {
            return Err(format!(
                "the best view shows {:.3} of the target in {} pixels, expected at least {GOOD_FRACTION} and {GOOD_PX}",
                self.best_fraction, self.best_px
            ));
        }
        if !(1..=MOST_MOVES).contains(&self.moves_to_good_view) {
            return Err(format!("moves_to_good_view must be 1 to {MOST_MOVES}, found {}", self.moves_to_good_view));
        }
        Ok(())
    }

    /// Checks that the statistics are this episode's and that the episode says what they say: pixels and share at
    /// the start and at the best view, and the fewest moves to a good one.
    pub fn check_statistics(&self, statistics: &[TargetStatistics]) -> Result<(), EpisodeError> {
        self.compare(statistics).map_err(|reason| EpisodeError::Invalid { episode: self.episode_id.clone(), reason })
    }

    fn compare(&self, statistics: &[TargetStatistics]) -> Result<(), String> {
        if statistics.iter().map(|s| s.instance_id).ne(self.valid_target_ids.iter().copied()) {
            return Err("statistics must follow valid_target_ids one to one".into());
        }
        statistics.iter().try_for_each(TargetStatistics::check)?;
        let Some(target) = statistics.first() else { return Err("no statistics of the target".into()) };
        let (start, best) = (self.start().map_err(|e| e.to_string())?, self.best().map_err(|e| e.to_string())?);
        for (name, view, px, fraction) in [
            ("start", start, self.start_px, self.start_fraction),
            ("best view", best, self.best_px, self.best_fraction),
        ] {
            let (seen, share) = (target.visible_px[view.index()], target.fraction(view));
            if seen != px || (share - fraction).abs() > 1e-6 {
                return Err(format!(
                    "{name}: the episode says {px} pixels and a share of {fraction:.4}, its statistics {seen} and \
                     {share:.4}"
                ));
            }
        }
        let good = good_view(target, start).ok_or_else(|| {
            format!("no reachable view shows {GOOD_FRACTION} of the target in {GOOD_PX} pixels or more")
        })?;
        if (good.best, good.moves) != (best, self.moves_to_good_view) {
            return Err(format!(
                "the best view is ({}, {}) and the first good one {} moves away, found ({}, {}) and {}",
                good.best.node(),
                good.best.pitch(),
                good.moves,
                self.best_node,
                self.best_pitch,
                self.moves_to_good_view
            ));
        }
        Ok(())
    }
}
