//! Making episodes: a target for a verb, distractors with near misses, a layout, and a start from
//! which the target is partly hidden although some viewpoint shows it well.

mod choose;
mod lay;

use std::collections::BTreeMap;

use rand::seq::{IndexedRandom, SliceRandom};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::catalogue::{Category, Split};
use crate::configuration::SceneConfiguration;
use crate::episode::{EPISODE_SCHEMA_VERSION, Episode, EpisodeObject, START_FRACTION};
use crate::ring::{Ring, Viewpoint};
use crate::targets::{TargetStatistics, estimate, statistics};
use crate::world::{Stage, WorldError};

/// Layouts that are tried for one episode. The hardest verb, pouring, took at most 32 for 48 seeds over four
/// scenes; more would only make a hopeless request fail later.
const ATTEMPTS: u64 = 60;
/// Layouts after which another valid thing may stand in full view at the start, and two of them are
/// laid: where all tall things are valid (for pouring), only they can hide one another.
const STRICT_ATTEMPTS: u64 = 24;
/// Pixels from which a target counts as seen (the smallest region that may end a search).
const SEEN_PX: u32 = 500;
/// Share of what could be seen of the target that some viewpoint must show.
const WELL_SEEN: f32 = 0.8;
/// Pixels that the target would have at the start if it stood alone, at least: its hiding must come
/// from other objects, not from being far away or cut by the picture's edge.
const START_UNOCCLUDED_PX: u32 = 500;
/// Reason for throwing a layout away.
const NOT_HIDDEN: &str = "no view where the target is partly hidden";

/// Categories valid for each verb.
pub type Validity = BTreeMap<String, Vec<Category>>;

/// What is asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    /// Name of the scene.
    pub scene: String,
    /// Verb; must be in the validity table.
    pub verb: String,
    /// The query in words.
    pub query: String,
    /// Seed.
    pub seed: u64,
    /// Identifier that the episode gets.
    pub episode_id: String,
}

/// Why layouts were thrown away, and how often.
pub type Rejections = BTreeMap<&'static str, u32>;

/// Why no episode was made.
#[derive(Debug, thiserror::Error)]
pub enum GenerateError {
    /// The verb has no row in the validity table.
    #[error("unknown verb `{found}`; known verbs: {}", known.join(", "))]
    Verb {
        /// Verb asked for.
        found: String,
        /// Verbs that exist.
        known: Vec<String>,
    },
    /// No object of the split can serve the verb.
    #[error("no object of split {split} is valid for `{verb}`")]
    NoTarget {
        /// Verb.
        verb: String,
        /// Split.
        split: Split,
    },
    /// Every layout was thrown away.
    #[error(
        "no episode for `{verb}` in scene `{scene}` with seed {seed}: {ATTEMPTS} layouts were thrown away ({}); \
         another seed or scene may have one",
        reasons(rejections)
    )]
    Exhausted {
        /// Verb.
        verb: String,
        /// Scene.
        scene: String,
        /// Seed.
        seed: u64,
        /// Reasons and counts.
        rejections: Rejections,
    },
    /// Objects, scenes or renderer.
    #[error(transparent)]
    World(#[from] WorldError),
}

impl From<crate::configuration::ConfigurationError> for GenerateError {
    fn from(error: crate::configuration::ConfigurationError) -> Self {
        Self::World(error.into())
    }
}

/// Reasons with how often each, the most frequent first.
fn reasons(rejections: &Rejections) -> String {
    let mut counted: Vec<_> = rejections.iter().collect();
    counted.sort_by_key(|(reason, times)| (std::cmp::Reverse(**times), **reason));
    counted.iter().map(|(reason, times)| format!("{reason}: {times}")).collect::<Vec<_>>().join(", ")
}

/// Viewpoints from which the target is partly hidden; if `strict`, only those where no other valid
/// thing stands in full view. `slack` widens the bounds, for estimates.
fn starts(targets: &[TargetStatistics], strict: bool, slack: f32) -> Vec<Viewpoint> {
    let Some((target, others)) = targets.split_first() else { return vec![] };
    let least = START_UNOCCLUDED_PX as f32 * (1.0 - 4.0 * slack);
    let hidden = |v: &Viewpoint| {
        let fraction = target.fraction(*v);
        let in_view =
            |o: &TargetStatistics| o.fraction(*v) > START_FRACTION[1] + slack && o.visible_px[v.index()] >= SEEN_PX;
        (START_FRACTION[0] - slack..=START_FRACTION[1] + slack).contains(&fraction)
            && target.unoccluded_px[v.index()] as f32 >= least
            && !(strict && others.iter().any(in_view))
    };
    Viewpoint::all().filter(hidden).collect()
}

/// Makes the episode of a request, and counts why layouts before it were thrown away. The same
/// request gives the same episode.
pub fn episode(stage: &Stage, validity: &Validity, request: &Request) -> Result<(Episode, Rejections), GenerateError> {
    let scene = stage.scene(&request.scene)?;
    let valid = validity.get(&request.verb).ok_or_else(|| GenerateError::Verb {
        found: request.verb.clone(),
        known: validity.keys().cloned().collect(),
    })?;
    let ring = Ring::of(scene);
    let mut rejections = Rejections::new();
    for attempt in 0..ATTEMPTS {
        let mut rng = ChaCha8Rng::seed_from_u64(request.seed);
        rng.set_stream(attempt);
        let strict = attempt < STRICT_ATTEMPTS;
        let records = choose::choose(stage, scene, validity, &request.verb, strict, &mut rng)
            .ok_or_else(|| GenerateError::NoTarget { verb: request.verb.clone(), split: scene.split })?;
        let mut reject = |reason| *rejections.entry(reason).or_insert(0) += 1;
        let objects = match lay::lay(stage, scene, records, &mut rng)? {
            Ok(objects) => objects,
            Err(reason) => {
                reject(reason);
                continue;
            }
        };
        let renderer = stage.renderer(scene, &objects, false)?;
        let middles = stage.middles(&objects)?;
        let asked: Vec<_> =
            objects.iter().zip(middles).filter(|(o, _)| valid.contains(&o.category)).map(|p| p.1).collect();
        if starts(&estimate(&renderer, &ring, &asked), strict, 0.08).is_empty() {
            reject(NOT_HIDDEN);
            continue;
        }
        let targets = statistics(&renderer, &ring, &asked);
        if !targets[0].well_seen(SEEN_PX, WELL_SEEN) {
            reject("the target is never seen well");
            continue;
        }
        match starts(&targets, strict, 0.0).choose(&mut rng) {
            Some(start) => return Ok((assemble(request, scene, objects, targets, *start), rejections)),
            None => reject(NOT_HIDDEN),
        }
    }
    Err(GenerateError::Exhausted {
        verb: request.verb.clone(),
        scene: request.scene.clone(),
        seed: request.seed,
        rejections,
    })
}

fn assemble(
    request: &Request,
    scene: &SceneConfiguration,
    mut objects: Vec<EpisodeObject>,
    statistics: Vec<TargetStatistics>,
    start: Viewpoint,
) -> Episode {
    let target = objects[0].instance_id;
    let valid_target_ids: Vec<u32> = statistics.iter().map(|s| s.instance_id).collect();
    let distractor_ids = objects[1..].iter().map(|o| o.instance_id).collect();
    let mut labels: Vec<String> = vec![];
    for o in objects.iter().filter(|o| valid_target_ids.contains(&o.instance_id)) {
        if !labels.iter().any(|l| l == o.category.id()) {
            labels.push(o.category.id().to_owned());
        }
    }
    objects.sort_by_key(|o| o.instance_id);
    Episode {
        schema_version: EPISODE_SCHEMA_VERSION,
        episode_id: request.episode_id.clone(),
        scene_id: scene.name.clone(),
        split: scene.split,
        seed: request.seed,
        query: request.query.clone(),
        verb: request.verb.clone(),
        target,
        objects,
        valid_target_ids,
        distractor_ids,
        candidate_sets: BTreeMap::from([("oracle".to_owned(), labels)]),
        start_node: start.node(),
        start_pitch: start.pitch(),
        statistics,
    }
}

/// The requests of a set: `count` episodes over the split's scenes in turn, verbs evenly in an order
/// drawn from `seed`. `queries` lists for each verb the words that it is asked with.
pub fn requests(
    scenes: &[SceneConfiguration],
    split: Split,
    queries: &BTreeMap<String, Vec<String>>,
    count: usize,
    seed: u64,
) -> Vec<Request> {
    let scenes: Vec<_> = scenes.iter().filter(|s| s.split == split && !s.weak_texture).collect();
    let verbs: Vec<(&String, &Vec<String>)> = queries.iter().filter(|(_, words)| !words.is_empty()).collect();
    if scenes.is_empty() || verbs.is_empty() {
        return vec![];
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut order = vec![];
    (0..count)
        .map(|i| {
            if order.is_empty() {
                order = (0..verbs.len()).collect();
                order.shuffle(&mut rng);
            }
            let (verb, words) = verbs[order.pop().unwrap_or(0)];
            Request {
                scene: scenes[i % scenes.len()].name.clone(),
                verb: verb.clone(),
                query: words[rng.random_range(0..words.len())].clone(),
                // 53 bits survive readers that keep JSON numbers as doubles.
                seed: rng.random::<u64>() >> 11,
                episode_id: format!("{split}_{i:04}"),
            }
        })
        .collect()
}

/// Makes all requested episodes, in their order, in parallel; the result does not depend on threads.
pub fn episodes(
    stage: &Stage,
    validity: &Validity,
    requests: &[Request],
) -> Result<Vec<(Episode, Rejections)>, GenerateError> {
    requests.par_iter().map(|r| episode(stage, validity, r)).collect()
}

#[cfg(test)]
mod tests;
