//! Buffers on the GPU, filled once or read back.

use fuse_camera::gpu::{Gpu, GpuError};

/// No binding may be empty; the largest element of an array is as long as this.
const SMALLEST: u64 = 64;

/// A storage buffer with room for `bytes`.
///
/// # Errors
/// If that is more than the GPU takes.
pub(super) fn storage(gpu: &Gpu, what: &'static str, bytes: u64) -> Result<wgpu::Buffer, GpuError> {
    let limits = gpu.device.limits();
    let allowed = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
    if bytes > allowed {
        return Err(GpuError::TooLarge { what: what.into(), needed: bytes, allowed });
    }
    let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
    let size = bytes.max(SMALLEST);
    Ok(gpu.device.create_buffer(&wgpu::BufferDescriptor { label: Some(what), size, usage, mapped_at_creation: false }))
}

/// A storage buffer that holds the pieces one after another.
///
/// # Errors
/// As [`storage`].
pub(super) fn filled<'a, T: bytemuck::Pod>(
    gpu: &Gpu,
    what: &'static str,
    pieces: impl Iterator<Item = &'a [T]> + Clone,
) -> Result<wgpu::Buffer, GpuError> {
    let bytes = pieces.clone().map(|piece| size_of_val(piece) as u64).sum();
    let buffer = storage(gpu, what, bytes)?;
    let mut offset = 0;
    for piece in pieces {
        gpu.queue.write_buffer(&buffer, offset, bytemuck::cast_slice(piece));
        offset += size_of_val(piece) as u64;
    }
    Ok(buffer)
}

/// A uniform buffer that holds `value`.
pub(super) fn uniform<T: bytemuck::Pod>(gpu: &Gpu, what: &'static str, value: &T) -> wgpu::Buffer {
    let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
    let size = size_of::<T>() as u64;
    let buffer =
        gpu.device.create_buffer(&wgpu::BufferDescriptor { label: Some(what), size, usage, mapped_at_creation: false });
    gpu.queue.write_buffer(&buffer, 0, bytemuck::bytes_of(value));
    buffer
}

/// Where results land on their way back.
pub(super) fn landing(gpu: &Gpu, bytes: u64) -> wgpu::Buffer {
    let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
    let size = bytes.max(SMALLEST);
    gpu.device.create_buffer(&wgpu::BufferDescriptor { label: Some("landing"), size, usage, mapped_at_creation: false })
}

/// Submits the work, copies `bytes` from `offset` of `from` on to `landing`, waits, and hands the words
/// to `take`.
///
/// # Errors
/// If the GPU fails.
pub(super) fn read<R>(
    gpu: &Gpu,
    mut encoder: wgpu::CommandEncoder,
    (from, offset, bytes): (&wgpu::Buffer, u64, u64),
    landing: &wgpu::Buffer,
    take: impl FnOnce(&[u32]) -> R,
) -> Result<R, GpuError> {
    encoder.copy_buffer_to_buffer(from, offset, landing, 0, bytes);
    gpu.queue.submit([encoder.finish()]);
    let slice = landing.slice(..bytes);
    slice.map_async(wgpu::MapMode::Read, |_| {});
    gpu.wait()?;
    let result = {
        let view = slice.get_mapped_range().map_err(|e| GpuError::Failed(e.to_string()))?;
        take(bytemuck::cast_slice(&view))
    };
    landing.unmap();
    Ok(result)
}
