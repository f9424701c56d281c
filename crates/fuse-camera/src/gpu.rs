//! Which GPU, if any: chosen once, by the same rule for every crate, and named with results.
//!
//! `auto` takes a real GPU and never one that is emulated on the CPU: our own CPU kernels are
//! faster. An emulated one (lavapipe, SwiftShader, WARP) serves tests and has to be allowed.

use std::fmt;
use std::str::FromStr;
use std::sync::{Arc, Mutex, PoisonError};

/// What is wrong with the GPU, or with the wish for one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GpuError {
    /// The name of a device is not known.
    #[error("device must be `auto`, `cpu` or `gpu`, found `{0}`")]
    Request(String),
    /// There is nothing that speaks Vulkan, Metal or Direct3D 12.
    #[error("no GPU was found: no adapter offers Vulkan, Metal or Direct3D 12 (is the driver installed?)")]
    NoAdapter,
    /// All there is is emulated.
    #[error("no GPU was found, only {0}, which the CPU emulates; set FUSE_SOFTWARE_GPU=1 to use it for tests")]
    OnlySoftware(String),
    /// The adapter was found but cannot be used.
    #[error("{adapter} cannot be used: {reason}")]
    Open {
        /// Its name.
        adapter: String,
        /// What the driver said.
        reason: String,
    },
    /// The work needs more than the adapter offers.
    #[error("{what} needs {needed} bytes in one buffer, the GPU allows {allowed}")]
    TooLarge {
        /// What.
        what: String,
        /// Bytes.
        needed: u64,
        /// Bytes.
        allowed: u64,
    },
    /// An image has more pixels a side than the adapter offers.
    #[error("an image of {width}x{height} pixels was asked for, the GPU allows {allowed} pixels a side")]
    ImageSize {
        /// Width asked for.
        width: u32,
        /// Height asked for.
        height: u32,
        /// Most pixels a side.
        allowed: u32,
    },
    /// The GPU failed at work.
    #[error("the GPU failed: {0}")]
    Failed(String),
}

impl GpuError {
    /// Whether the machine failed, rather than the caller having asked for what there is not.
    pub fn is_failure(&self) -> bool {
        matches!(self, Self::Open { .. } | Self::Failed(_))
    }
}

/// What a caller asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// A real GPU if there is one, else the CPU.
    Auto,
    /// The CPU.
    Cpu,
    /// A GPU or an error.
    Gpu,
}

impl FromStr for Request {
    type Err = GpuError;
    fn from_str(name: &str) -> Result<Self, GpuError> {
        match name {
            "auto" => Ok(Self::Auto),
            "cpu" => Ok(Self::Cpu),
            "gpu" => Ok(Self::Gpu),
            other => Err(GpuError::Request(other.into())),
        }
    }
}

/// Whether an emulated GPU will do where [`Request::Gpu`] finds no real one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Software {
    /// It will not.
    Refused,
    /// It will, if there is no real one.
    Allowed,
}

impl Software {
    /// Allowed if the environment variable `FUSE_SOFTWARE_GPU` is 1.
    pub fn from_env() -> Self {
        if std::env::var("FUSE_SOFTWARE_GPU").is_ok_and(|v| v == "1") { Self::Allowed } else { Self::Refused }
    }
}

/// What the work will run on. Its `Display` says so, for logs and records.
#[derive(Clone, Debug)]
pub enum Choice {
    /// The CPU, at [`crate::simd::level`].
    Cpu,
    /// A GPU.
    Gpu(Gpu),
}

impl fmt::Display for Choice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cpu => write!(f, "cpu ({})", crate::simd::level().name()),
            Self::Gpu(gpu) => write!(f, "gpu ({})", gpu.name()),
        }
    }
}

/// Takes what `request` asks for. `auto` falls back to the CPU where there is no real GPU; one that
/// is there but cannot be opened is an error.
///
/// # Errors
/// If a GPU is asked for and there is none, or it cannot be opened.
pub fn choose(request: Request, software: Software) -> Result<Choice, GpuError> {
    match request {
        Request::Cpu => Ok(Choice::Cpu),
        Request::Gpu => Gpu::open(software).map(Choice::Gpu),
        Request::Auto => match Gpu::open(Software::Refused) {
            Ok(gpu) => Ok(Choice::Gpu(gpu)),
            Err(GpuError::NoAdapter | GpuError::OnlySoftware(_)) => Ok(Choice::Cpu),
            Err(e) => Err(e),
        },
    }
}

/// An open GPU. Clones share it.
#[derive(Clone, Debug)]
pub struct Gpu {
    /// wgpu's device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    name: String,
    software: bool,
    failure: Arc<Mutex<Option<String>>>,
}

impl Gpu {
    /// Opens the best real GPU (discrete before integrated before virtual), or where there is none
    /// and it is allowed, an emulated one.
    ///
    /// # Errors
    /// If there is none, or it cannot be opened.
    pub fn open(software: Software) -> Result<Self, GpuError> {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
        let instance = wgpu::Instance::new(descriptor);
        let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
        let infos: Vec<_> = adapters.iter().map(wgpu::Adapter::get_info).collect();
        let index = pick(&infos, software)?;
        Self::from_adapter(&adapters[index], &infos[index])
    }

    fn from_adapter(adapter: &wgpu::Adapter, info: &wgpu::AdapterInfo) -> Result<Self, GpuError> {
        let offered = adapter.limits();
        // WebGPU's defaults, so that what runs here runs everywhere; only buffers may be as large
        // as the adapter allows.
        let limits = wgpu::Limits {
            max_buffer_size: offered.max_buffer_size,
            max_storage_buffer_binding_size: offered.max_storage_buffer_binding_size,
            ..wgpu::Limits::default()
        };
        let descriptor = wgpu::DeviceDescriptor { label: Some("fuse"), required_limits: limits, ..Default::default() };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|e| GpuError::Open { adapter: info.name.clone(), reason: e.to_string() })?;
        let failure = Arc::new(Mutex::new(None));
        let note = |failure: &Arc<Mutex<Option<String>>>, what: String| {
            failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(what);
        };
        let of_device = Arc::clone(&failure);
        device.on_uncaptured_error(Arc::new(move |e: wgpu::Error| note(&of_device, e.to_string())));
        let of_device = Arc::clone(&failure);
        device.set_device_lost_callback(move |reason, what| {
            note(&of_device, format!("device lost ({reason:?}): {what}"))
        });
        let name = format!("{}, {:?}", info.name, info.backend);
        Ok(Self { device, queue, name, software: is_software(info), failure })
    }

    /// Its name and the interface it is driven through, as `NVIDIA L4, Vulkan`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether the CPU emulates it.
    pub fn is_software(&self) -> bool {
        self.software
    }

    /// What went wrong since it was opened.
    ///
    /// # Errors
    /// The first failure that the driver reported.
    pub fn check(&self) -> Result<(), GpuError> {
        match &*self.failure.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(what) => Err(GpuError::Failed(what.clone())),
            None => Ok(()),
        }
    }

    /// Waits until all submitted work is done.
    ///
    /// # Errors
    /// As [`Self::check`], and if the wait itself fails.
    pub fn wait(&self) -> Result<(), GpuError> {
        self.device.poll(wgpu::PollType::wait_indefinitely()).map_err(|e| GpuError::Failed(e.to_string()))?;
        self.check()
    }
}

/// Drivers that emulate a GPU; not all of them say so in their type.
const EMULATORS: [&str; 4] = ["llvmpipe", "lavapipe", "swiftshader", "basic render"];

fn is_software(info: &wgpu::AdapterInfo) -> bool {
    let name = info.name.to_lowercase();
    info.device_type == wgpu::DeviceType::Cpu || EMULATORS.iter().any(|e| name.contains(e))
}

/// Index of the adapter to take.
fn pick(infos: &[wgpu::AdapterInfo], software: Software) -> Result<usize, GpuError> {
    let rank = |info: &wgpu::AdapterInfo| match info.device_type {
        _ if is_software(info) => 4,
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        _ => 3,
    };
    let (index, info) = infos.iter().enumerate().min_by_key(|(i, info)| (rank(info), *i)).ok_or(GpuError::NoAdapter)?;
    if is_software(info) && software == Software::Refused {
        return Err(GpuError::OnlySoftware(info.name.clone()));
    }
    Ok(index)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn adapter(name: &str, device_type: wgpu::DeviceType) -> wgpu::AdapterInfo {
        wgpu::AdapterInfo { name: name.into(), ..wgpu::AdapterInfo::new(device_type, wgpu::Backend::Vulkan) }
    }

    #[test]
    fn a_real_gpu_comes_first_and_an_emulated_one_only_if_allowed() {
        use wgpu::DeviceType::{Cpu, DiscreteGpu, IntegratedGpu, Other};
        let llvmpipe = adapter("llvmpipe (LLVM 15.0.6, 256 bits)", Cpu);
        // One that does not admit it.
        let swiftshader = adapter("SwiftShader Device (LLVM 10.0.0)", Other);
        let (small, large) = (adapter("Intel UHD 620", IntegratedGpu), adapter("NVIDIA L4", DiscreteGpu));
        let all = [llvmpipe.clone(), small, swiftshader.clone(), large];
        for software in [Software::Refused, Software::Allowed] {
            assert_eq!(pick(&all, software), Ok(3));
            assert_eq!(pick(&all[..3], software), Ok(1));
            assert_eq!(pick(&[], software), Err(GpuError::NoAdapter));
        }
        for emulated in [llvmpipe, swiftshader] {
            let list = [emulated.clone()];
            assert_eq!(pick(&list, Software::Refused), Err(GpuError::OnlySoftware(emulated.name)));
            assert_eq!(pick(&list, Software::Allowed), Ok(0));
        }
    }

    #[test]
    fn auto_never_takes_an_emulated_gpu_and_says_what_it_took() {
        let choice = choose(Request::Auto, Software::Allowed).unwrap();
        let text = choice.to_string();
        match choice {
            Choice::Cpu => assert_eq!(text, format!("cpu ({})", crate::simd::level().name())),
            Choice::Gpu(gpu) => {
                assert!(!gpu.is_software(), "{text}");
                assert_eq!(text, format!("gpu ({})", gpu.name()));
            }
        }
    }

    #[test]
    fn wishes_are_read_by_name() {
        assert_eq!(["auto", "cpu", "gpu"].map(str::parse), [Ok(Request::Auto), Ok(Request::Cpu), Ok(Request::Gpu)]);
        let error = "cuda".parse::<Request>().unwrap_err();
        assert_eq!(error.to_string(), "device must be `auto`, `cpu` or `gpu`, found `cuda`");
    }
}
