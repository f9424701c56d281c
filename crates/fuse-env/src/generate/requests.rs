//! What a set asks for: verbs and scenes evenly, words and seeds drawn.

use std::collections::BTreeMap;

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::catalogue::Split;
use crate::configuration::SceneConfiguration;

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

/// The requests of a set: `count` episodes over the split's scenes in turn, verbs evenly in an order
/// drawn from `seed`, named `set` and their number. `queries` lists for each verb the words that it is asked with.
/// The first requests of a larger set are those of a smaller one.
pub fn requests(
    scenes: &[SceneConfiguration],
    set: &str,
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
                episode_id: format!("{set}_{i:04}"),
            }
        })
        .collect()
}
