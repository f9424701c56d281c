//! Arrays on the GPU. All numbers are 32 bits wide; lengths are in such words.

use fuse_camera::gpu::{Gpu, GpuError};

use crate::SplatError;

const WORD: u64 = 4;

/// A storage buffer that grows.
#[derive(Debug)]
pub(crate) struct Array {
    label: &'static str,
    buffer: wgpu::Buffer,
    words: usize,
}

impl Array {
    pub fn new(gpu: &Gpu, label: &'static str) -> Self {
        // No binding may be empty; four words are the largest element of an array that is bound
        // before its length is known.
        Self { label, buffer: storage(gpu, label, 4 * WORD), words: 4 }
    }

    /// From numbers.
    ///
    /// # Errors
    /// If they are more than the GPU takes.
    pub fn with<T: bytemuck::Pod>(gpu: &Gpu, label: &'static str, numbers: &[T]) -> Result<Self, SplatError> {
        let mut array = Self::new(gpu, label);
        array.write(gpu, numbers)?;
        Ok(array)
    }

    /// Sets the length. What the array held is lost if it grows beyond its room.
    ///
    /// # Errors
    /// If that is more than the GPU takes.
    pub fn resize(&mut self, gpu: &Gpu, words: usize) -> Result<(), SplatError> {
        let needed = words.max(1) as u64 * WORD;
        let limits = gpu.device.limits();
        let allowed = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        if needed > allowed {
            return Err(GpuError::TooLarge { what: self.label.into(), needed, allowed }.into());
        }
        if needed > self.buffer.size() {
            // A quarter in reserve: lists of pairs change from view to view.
            let room = (needed + needed / 4).min(allowed) / WORD * WORD;
            self.buffer = storage(gpu, self.label, room);
        }
        self.words = words.max(1);
        Ok(())
    }

    /// Replaces the contents.
    ///
    /// # Errors
    /// As [`Self::resize`].
    pub fn write<T: bytemuck::Pod>(&mut self, gpu: &Gpu, numbers: &[T]) -> Result<(), SplatError> {
        let bytes: &[u8] = bytemuck::cast_slice(numbers);
        self.resize(gpu, bytes.len() / WORD as usize)?;
        gpu.queue.write_buffer(&self.buffer, 0, bytes);
        Ok(())
    }

    /// All of it, no longer than its length: shaders ask for that.
    pub fn binding(&self) -> wgpu::BindingResource<'_> {
        let size = wgpu::BufferSize::new(self.words as u64 * WORD);
        wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer: &self.buffer, offset: 0, size })
    }

    pub fn clear(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.clear_buffer(&self.buffer, 0, Some(self.words as u64 * WORD));
    }

    /// Copies `words` words from `first` on to `to` and waits for them.
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn read<T: bytemuck::Pod>(
        &self,
        gpu: &Gpu,
        mut encoder: wgpu::CommandEncoder,
        range: std::ops::Range<usize>,
        landing: &mut Landing,
    ) -> Result<Vec<T>, SplatError> {
        let size = range.len() as u64 * WORD;
        if size > landing.buffer.size() {
            *landing = Landing::new(gpu, size);
        }
        encoder.copy_buffer_to_buffer(&self.buffer, range.start as u64 * WORD, &landing.buffer, 0, size);
        gpu.queue.submit([encoder.finish()]);
        let slice = landing.buffer.slice(..size);
        slice.map_async(wgpu::MapMode::Read, |_| {});
        gpu.wait()?;
        let failed = |e: wgpu::MapRangeError| GpuError::Failed(e.to_string());
        let numbers = bytemuck::pod_collect_to_vec(&slice.get_mapped_range().map_err(failed)?);
        landing.buffer.unmap();
        Ok(numbers)
    }
}

fn storage(gpu: &Gpu, label: &'static str, size: u64) -> wgpu::Buffer {
    let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
    gpu.device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false })
}

/// A uniform buffer, for some stages a storage buffer, that holds `value`.
pub(crate) fn uniform<T: bytemuck::Pod>(gpu: &Gpu, label: &'static str, value: &T) -> wgpu::Buffer {
    let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST;
    let size = size_of::<T>() as u64;
    let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size,
        usage,
        mapped_at_creation: false,
    });
    gpu.queue.write_buffer(&buffer, 0, bytemuck::bytes_of(value));
    buffer
}

/// Where numbers land on their way back; kept, since making one takes longer than the copy.
#[derive(Debug)]
pub(crate) struct Landing {
    buffer: wgpu::Buffer,
}

impl Landing {
    pub fn new(gpu: &Gpu, size: u64) -> Self {
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        let descriptor = wgpu::BufferDescriptor { label: Some("landing"), size, usage, mapped_at_creation: false };
        Self { buffer: gpu.device.create_buffer(&descriptor) }
    }
}
