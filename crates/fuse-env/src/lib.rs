//! The world of the benchmark: tabletop objects, scene configurations, placement, the ring of
//! viewpoints, episodes and the metrics that know the truth.

pub mod catalogue;
pub mod category;
pub mod configuration;
pub mod difficulty;
pub mod episode;
pub mod generate;
pub mod import;
pub mod library;
pub mod metrics;
pub mod objects;
pub mod placement;
pub mod randomized;
pub mod ring;
pub mod room;
pub mod surfaces;
pub mod targets;
pub mod world;
