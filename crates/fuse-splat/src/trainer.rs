//! Training that stops and resumes while views arrive.

use std::time::Instant;

use fuse_camera::simd::Level;
use fuse_camera::{Camera, RgbBuffer};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng as _;

use crate::cpu::adam::Step;
use crate::cpu::{Pipeline, StageSeconds, lap, project_backward};
use crate::densify::{Changes, densify};
use crate::order::Order;
use crate::shot::Shot;
use crate::surgery::Patient;
use crate::{Gaussians, SplatError, TrainerConfig, schedule};

/// Opacities are reset to at most this, as in the original.
const RESET_OPACITY: f32 = 0.01;

/// What a call of [`Trainer::refine`] did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RefineStats {
    /// Iterations of this call.
    pub iterations: u32,
    /// Iterations since the trainer was made.
    pub total_iterations: u32,
    /// Mean loss of the first tenth of the call (at least one iteration).
    pub loss_first: f64,
    /// Mean loss of the last tenth of the call.
    pub loss: f64,
    /// Gaussians at the end.
    pub gaussians: usize,
    /// Gaussians cloned, split and removed.
    pub changes: Changes,
    /// How often opacities were reset.
    pub opacity_resets: u32,
    /// Wall-clock seconds of the call.
    pub seconds: f64,
    /// The same by stage.
    pub stages: StageSeconds,
}

/// Fits Gaussians to views that arrive one by one. Iterations, moments and statistics carry over
/// from one [`Trainer::refine`] to the next. Same seed, same calls: same bits, at any number of
/// threads and one SIMD level.
#[derive(Debug)]
pub struct Trainer {
    pub(crate) config: TrainerConfig,
    pub(crate) level: Level,
    pub(crate) patient: Patient,
    pub(crate) views: Vec<Shot>,
    pub(crate) order: Order,
    pub(crate) rng: ChaCha8Rng,
    pub(crate) iteration: u32,
    /// Steps of Adam; fewer than iterations where a step stands for several.
    pub(crate) steps: u32,
    pub(crate) densify_due: bool,
    pub(crate) reset_due: bool,
    pipeline: Pipeline,
    #[cfg(feature = "gpu")]
    gpu: Option<crate::gpu::Engine>,
}

impl Trainer {
    /// # Errors
    /// If a setting is out of range (it is named), or there are no Gaussians.
    pub fn new(gaussians: Gaussians, config: TrainerConfig) -> Result<Self, SplatError> {
        Self::with_level(fuse_camera::simd::level(), gaussians, config)
    }

    /// [`Self::new`] with a given SIMD level.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_level(level: Level, gaussians: Gaussians, config: TrainerConfig) -> Result<Self, SplatError> {
        config.check()?;
        if gaussians.is_empty() {
            return Err(SplatError::Input("training needs at least one Gaussian, found none".into()));
        }
        Ok(Self {
            level,
            patient: Patient::new(gaussians.table),
            views: Vec::new(),
            order: Order::default(),
            rng: ChaCha8Rng::seed_from_u64(config.seed),
            iteration: 0,
            steps: 0,
            densify_due: false,
            reset_due: false,
            pipeline: Pipeline::new(level),
            #[cfg(feature = "gpu")]
            gpu: None,
            config,
        })
    }

    /// [`Self::new`] that trains on a GPU. Schedule, densification and random numbers are the same;
    /// [`RefineStats::stages`] is filled if the device is [timed](crate::gpu::Device::timed).
    ///
    /// # Errors
    /// As [`Self::new`].
    #[cfg(feature = "gpu")]
    pub fn with_device(
        device: &crate::gpu::Device,
        gaussians: Gaussians,
        config: TrainerConfig,
    ) -> Result<Self, SplatError> {
        Ok(Self { gpu: Some(crate::gpu::Engine::new(device)), ..Self::new(gaussians, config)? })
    }

    /// A twin that goes its own way from here, as if each had been called alike so far. Views' pictures
    /// are shared, Gaussians and moments copied.
    #[must_use]
    pub fn fork(&self) -> Self {
        Self {
            config: self.config.clone(),
            level: self.level,
            patient: self.patient.clone(),
            views: self.views.clone(),
            order: self.order.clone(),
            rng: self.rng.clone(),
            iteration: self.iteration,
            steps: self.steps,
            densify_due: self.densify_due,
            reset_due: self.reset_due,
            pipeline: Pipeline::new(self.level),
            #[cfg(feature = "gpu")]
            gpu: self.gpu.as_ref().map(crate::gpu::Engine::fork),
        }
    }

    /// What decides the last bits, as `cpu (avx2+fma)` or `gpu (NVIDIA L4, Vulkan)`.
    pub fn runs_on(&self) -> String {
        #[cfg(feature = "gpu")]
        if let Some(gpu) = &self.gpu {
            return format!("gpu ({})", gpu.name());
        }
        format!("cpu ({})", self.level.name())
    }

    /// Adds a view to train on; returns its index.
    ///
    /// # Errors
    /// If image and camera differ in size, or are larger than 4096 pixels a side.
    pub fn add_view(&mut self, image: &RgbBuffer, camera: &Camera) -> Result<usize, SplatError> {
        let shot = Shot::new(self.level, image, camera, &self.config)?;
        #[cfg(feature = "gpu")]
        if let Some(gpu) = &mut self.gpu {
            gpu.add_view(image)?;
            if self.config.fine_iterations.is_some() {
                gpu.add_view(&crate::shot::halve(image)?)?;
            }
        }
        self.views.push(shot);
        self.order.add(self.views.len() - 1);
        Ok(self.views.len() - 1)
    }

    /// Replaces a view's camera (after a bundle adjustment, say).
    ///
    /// # Errors
    /// If there is no such view, or the image size differs.
    pub fn set_camera(&mut self, index: usize, camera: &Camera) -> Result<(), SplatError> {
        let count = self.views.len();
        let shot = self
            .views
            .get_mut(index)
            .ok_or_else(|| SplatError::Input(format!("view {index} does not exist, there are {count}")))?;
        shot.set_camera(index, camera)
    }

    /// Adds Gaussians at newly found points, initialised as the first ones were, without moments;
    /// returns how many were added: no more than `max_gaussians` allows.
    ///
    /// # Errors
    /// As [`Gaussians::add_points`].
    pub fn add_points(&mut self, xyz: &[[f32; 3]], rgb: &[[f32; 3]]) -> Result<usize, SplatError> {
        let mut grown = self.gaussians();
        grown.add_points(xyz, rgb)?;
        let before = self.patient.len();
        let added = xyz.len().min(self.config.max_gaussians.saturating_sub(before));
        for i in before..before + added {
            self.patient.push(&grown.vector(i));
        }
        Ok(added)
    }

    /// A copy of the Gaussians as they are now.
    pub fn gaussians(&self) -> Gaussians {
        Gaussians { table: self.patient.parameters.clone() }
    }

    /// Iterations since the trainer was made.
    pub fn iteration(&self) -> u32 {
        self.iteration
    }

    /// Number of views.
    pub fn view_count(&self) -> usize {
        self.views.len()
    }

    /// Runs `iterations` more, each step on one view; without [`TrainerConfig::favour_new`] every view
    /// comes once before any comes again.
    ///
    /// # Errors
    /// If there are no views.
    pub fn refine(&mut self, iterations: u32) -> Result<RefineStats, SplatError> {
        self.refine_while(iterations, 0, &mut || true)
    }

    /// [`Self::refine`] that asks before each step whether to go on. `following` more are to come in
    /// later calls: calls that follow one another do what one long call does, if their lengths are
    /// multiples of [`TrainerConfig::step_iterations`].
    ///
    /// # Errors
    /// As [`Self::refine`].
    pub fn refine_while(
        &mut self,
        iterations: u32,
        following: u32,
        proceed: &mut dyn FnMut() -> bool,
    ) -> Result<RefineStats, SplatError> {
        if self.views.is_empty() && iterations > 0 {
            return Err(SplatError::Input("training needs at least one view, found none".into()));
        }
        let start = Instant::now();
        let extent = self.extent();
        let mut stats = RefineStats::default();
        let mut losses = Vec::with_capacity(iterations as usize);
        self.pipeline.seconds = StageSeconds::default();
        self.lend()?;
        while stats.iterations < iterations && proceed() {
            let rest = iterations - stats.iterations;
            let left = rest.saturating_add(following);
            self.maintain(extent, left, &mut stats)?;
            let step = rest.min(self.config.step_iterations);
            self.iteration += step;
            self.steps += 1;
            stats.iterations += step;
            losses.extend(self.iterate(extent, left, step)?);
            self.densify_due |= schedule::densify_after(&self.config, self.iteration, step);
            self.reset_due |= schedule::reset_after(&self.config, self.iteration, step);
        }
        self.take_back()?;
        losses.extend(self.late_losses()?);
        let tenth = losses.len().div_ceil(10);
        let mean = |l: &[f64]| l.iter().sum::<f64>() / l.len().max(1) as f64;
        stats.loss_first = mean(&losses[..tenth]);
        stats.loss = mean(&losses[losses.len() - tenth..]);
        stats.total_iterations = self.iteration;
        stats.gaussians = self.patient.len();
        stats.stages = self.pipeline.seconds;
        stats.seconds = start.elapsed().as_secs_f64();
        Ok(stats)
    }

    /// What the last iteration left to do. Done before the next iteration and not after the last,
    /// so that what is looked at between two calls has been trained since it was changed.
    fn maintain(&mut self, extent: f32, left: u32, stats: &mut RefineStats) -> Result<(), SplatError> {
        let reset = self.reset_due && left >= self.config.opacity_reset_margin;
        if !self.densify_due && !reset {
            return Ok(());
        }
        let mut clock = Instant::now();
        self.take_back()?;
        if std::mem::take(&mut self.densify_due) {
            let large = self.iteration > self.config.opacity_reset_interval;
            let changes = densify(&mut self.patient, &self.config, extent, large, &mut self.rng);
            stats.changes.cloned += changes.cloned;
            stats.changes.split += changes.split;
            stats.changes.pruned += changes.pruned;
        }
        if reset {
            self.reset_due = false;
            self.patient.reset_opacity(RESET_OPACITY);
            stats.opacity_resets += 1;
        }
        self.lend()?;
        lap(&mut clock, &mut self.pipeline.seconds.densify);
        Ok(())
    }

    /// Hands the Gaussians to the GPU, if there is one, …
    fn lend(&mut self) -> Result<(), SplatError> {
        #[cfg(feature = "gpu")]
        if let Some(gpu) = &mut self.gpu {
            gpu.upload(&self.patient)?;
        }
        Ok(())
    }

    /// … and takes them back.
    fn take_back(&mut self) -> Result<(), SplatError> {
        #[cfg(feature = "gpu")]
        if let Some(gpu) = &mut self.gpu {
            gpu.download(&mut self.patient)?;
        }
        Ok(())
    }

    /// Losses that [`Self::iterate`] did not wait for.
    fn late_losses(&mut self) -> Result<Vec<f64>, SplatError> {
        #[cfg(feature = "gpu")]
        if let Some(gpu) = &mut self.gpu {
            let densify = self.pipeline.seconds.densify;
            self.pipeline.seconds = StageSeconds { densify, ..gpu.take_seconds() };
            return gpu.take_losses();
        }
        Ok(Vec::new())
    }

    /// One iteration, with so many `left`, itself among them; returns the loss if it is known already.
    fn iterate(&mut self, extent: f32, left: u32, step: u32) -> Result<Option<f64>, SplatError> {
        let index = self.order.next(self.views.len(), self.config.favour_new, &mut self.rng);
        let (_half, view, target) = self.views[index].at(schedule::coarse(&self.config, left));
        let degree = schedule::degree(&self.config, self.iteration);
        let background = self.config.background;
        let rates = schedule::rates(&self.config, self.iteration, step, extent);
        #[cfg(feature = "gpu")]
        if let Some(gpu) = &mut self.gpu {
            let lambda = self.config.lambda_dssim;
            let settings = crate::gpu::Settings { degree, background, lambda, slot: 0 };
            // A view's picture at half the resolution lies behind the picture itself.
            let stride = 1 + usize::from(self.config.fine_iterations.is_some());
            gpu.iterate(stride * index + usize::from(_half), view, settings, &rates, self.steps)?;
            return Ok(None);
        }
        self.pipeline.forward(view, degree, background, &self.patient.parameters, false);
        let loss = self.pipeline.backward(view, target, self.config.lambda_dssim);

        let mut clock = Instant::now();
        let step = Step::new(&rates, self.steps, degree);
        let Patient { parameters, moments, density } = &mut self.patient;
        let gathered = self.pipeline.gathered(view, degree);
        project_backward::step(self.level, gathered, &step, parameters, moments, density);
        lap(&mut clock, &mut self.pipeline.seconds.project_backward);
        Ok(Some(loss))
    }

    /// Extent of the scene, metres.
    fn extent(&self) -> f32 {
        self.config.extent.unwrap_or_else(|| {
            let centers: Vec<_> = self.views.iter().map(|shot| shot.camera.pose.center().coords).collect();
            let mean = centers.iter().sum::<nalgebra::Vector3<f64>>() / centers.len().max(1) as f64;
            let radius = centers.iter().map(|c| (c - mean).norm()).fold(0.0, f64::max);
            // A single view has no extent; rates must not vanish.
            if radius > 0.0 { (1.1 * radius) as f32 } else { 1.0 }
        })
    }
}
