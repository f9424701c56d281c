//! Semantic and geometric evidence, and what is decided from it (supplement, "Semantic and
//! Geometric Evidence", "Depth-Proximity Stopping Rule", "Confidence Gate").
//!
//! In the order in which an observation is worked on: [`ssnr`] compares it with a rendering of
//! the map, [`semantic`] lays detections over it, [`fusion`] adds the two, [`regions`] scores the
//! sensing actions, [`gate`] says how sure a planner is. [`depth`], [`grounding`] and [`patience`]
//! decide when to stop.
//!
//! Images are row-major [`View`]s; depth is in metres. Every result is bit-identical for any
//! number of threads.
//!
//! ```
//! use fuse_evidence::{View, fusion, regions, semantic, ssnr};
//!
//! let observed = vec![[90u8, 120, 30]; 16 * 12];
//! let view = View::new("observed", 16, 12, &observed)?;
//! let geometric = ssnr::geometric_uncertainty(view, None, &Default::default())?;
//! let mask = vec![true; 16 * 12];
//! let semantic = semantic::semantic_map(16, 12, &[&mask], &[0.9], false)?;
//! let evidence = fusion::fuse(&semantic, &geometric, 1.0, 1.0)?;
//! let scores = regions::action_scores((&evidence).into(), regions::Coupled::Union)?;
//! assert!((scores[7] - 1.3).abs() < 1e-6); // 0.9 + 0.4: no rendering is 0 dB everywhere
//! # Ok::<(), fuse_evidence::EvidenceError>(())
//! ```

pub mod depth;
mod error;
pub mod fusion;
pub mod gate;
pub mod grounding;
pub mod patience;
pub mod recycle;
pub mod regions;
pub mod semantic;
pub mod ssnr;
mod view;

pub use error::EvidenceError;
pub use view::View;
