//! The launches of an update on a GPU: kernels compiled when first needed, an update replayed as a CUDA graph.
//!
//! All work of one machine goes through one stream, in order. This is the one file of herd with `unsafe` in it: what a
//! kernel does with its arguments is out of Rust's sight. `launches` says what they are; the tests hold what becomes of
//! the networks against the CPU's trainer, as they do with `host`.

#![expect(unsafe_code, reason = "launching kernels")]

use super::super::error::Error;
use super::Machine;
use super::launches::{Gather, Launch, Losses, Moved, NETWORKS, PRODUCTS, Product};
use cudarc::driver::sys::{CUgraphInstantiate_flags, CUstreamCaptureMode};
use cudarc::driver::{
    CudaContext, CudaFunction, CudaGraph, CudaModule, CudaSlice, CudaStream, DeviceRepr, LaunchConfig, PushKernelArg,
};
use cudarc::nvrtc::{CompileOptions, compile_ptx_with_opts};
use std::fmt::{self, Debug, Display, Formatter};
use std::sync::{Arc, OnceLock};

/// Threads of a block, `THREADS` of the kernels; `losses` is one block of more.
const THREADS: u32 = 256;
const LOSSES_THREADS: u32 = 1024;
/// Tiles of products, as the kernels have them.
const TILES: [Tile; 2] = [
    Tile { size: "small", side: 32, threads: [256, 256, 256] },
    Tile { size: "medium", side: 64, threads: [128, 256, 128] },
];
/// Medium tiles that keep a GPU of a hundred multiprocessors busy; measured on an H200.
const ENOUGH_TILES: u32 = 128;

struct Tile {
    size: &'static str,
    /// Rows and columns.
    side: u32,
    /// By `Mode`.
    threads: [u32; 3],
}

impl Tile {
    /// How many these products take.
    fn count(&self, products: &[Product]) -> u32 {
        products.iter().map(|p| p.m.div_ceil(self.side) * p.n.div_ceil(self.side) * p.parts).sum()
    }
}

/// The first GPU and the kernels on it, shared by all machines of the process.
struct Gpu {
    context: Arc<CudaContext>,
    kernels: Kernels,
}

struct Kernels {
    /// By `Mode`, by size.
    products: [[CudaFunction; TILES.len()]; 3],
    gather: CudaFunction,
    losses: CudaFunction,
    sum: CudaFunction,
    step: CudaFunction,
}

/// The arena and the replay memory in a GPU's memory.
pub(super) struct Cuda {
    gpu: &'static Gpu,
    stream: Arc<CudaStream>,
    arena: CudaSlice<f32>,
    memory: CudaSlice<f32>,
    /// The update's number in its round and a slot for every transition.
    feed: CudaSlice<u32>,
    reward_scale: f32,
    /// By the program's number, once it has run.
    graphs: [Option<Graph>; 2],
}

struct Graph(CudaGraph);

#[derive(Clone, Copy)]
#[repr(C)]
struct Products([Product; PRODUCTS]);

#[derive(Clone, Copy)]
#[repr(C)]
struct AllMoved([Moved; NETWORKS]);

// SAFETY: `repr(C)`, nothing but u32, f32 and an enum that is a u32; the kernels declare the same.
unsafe impl DeviceRepr for Gather {}
// SAFETY: as above.
unsafe impl DeviceRepr for Losses {}
// SAFETY: as above.
unsafe impl DeviceRepr for Products {}
// SAFETY: as above.
unsafe impl DeviceRepr for AllMoved {}
// SAFETY: graphs are not tied to a thread, and only the `&mut self` of their machine uses them.
unsafe impl Send for Graph {}

/// Fails without a GPU that herd can use.
pub(super) fn check() -> Result<(), Error> {
    gpu().map(|_| ())
}

fn gpu() -> Result<&'static Gpu, Error> {
    static GPU: OnceLock<Result<Gpu, String>> = OnceLock::new();
    GPU.get_or_init(Gpu::new).as_ref().map_err(|error| Error::NoGpu(error.clone()))
}

impl Gpu {
    fn new() -> Result<Self, String> {
        // SAFETY: both only try to open the library.
        let (driver, nvrtc) =
            unsafe { (cudarc::driver::sys::is_culib_present(), cudarc::nvrtc::sys::is_culib_present()) };
        for (library, found) in [("libcuda (NVIDIA's driver)", driver), ("libnvrtc (the CUDA toolkit)", nvrtc)] {
            if !found {
                return Err(format!("{library} is not found; LD_LIBRARY_PATH may name its directory"));
            }
        }
        let context = CudaContext::new(0).map_err(text)?;
        // SAFETY: every slice stays with the stream that made it.
        unsafe { context.disable_event_tracking() };
        let (major, minor) = context.compute_capability().map_err(text)?;
        // The kernels copy in the background, which older ones cannot.
        if major < 8 {
            return Err(format!("its compute capability is {major}.{minor}, expected 8.0 or later"));
        }
        let options = vec![format!("--gpu-architecture=compute_{major}{minor}")];
        let options = CompileOptions { options, ..CompileOptions::default() };
        let ptx = compile_ptx_with_opts(include_str!("kernels.cu"), options).map_err(text)?;
        let kernels = Kernels::new(&context.load_module(ptx).map_err(text)?)?;
        Ok(Self { context, kernels })
    }
}

impl Kernels {
    fn new(module: &Arc<CudaModule>) -> Result<Self, String> {
        let kernel = |name: &str| module.load_function(name).map_err(|error| format!("kernel {name}: {error}"));
        let sizes = |mode: &str| -> Result<[CudaFunction; TILES.len()], String> {
            let [small, medium] = TILES.map(|tile| kernel(&format!("{mode}_{}", tile.size)));
            Ok([small?, medium?])
        };
        Ok(Self {
            products: [sizes("forward")?, sizes("back")?, sizes("weight")?],
            gather: kernel("gather")?,
            losses: kernel("losses")?,
            sum: kernel("sum")?,
            step: kernel("step")?,
        })
    }
}

impl Cuda {
    /// An arena of zeros, and room for the slots of a minibatch of `n`.
    pub(super) fn new(len: usize, n: usize, reward_scale: f32) -> Result<Self, Error> {
        let gpu = gpu()?;
        let stream = gpu.context.new_stream().map_err(failed)?;
        Ok(Self {
            arena: stream.alloc_zeros(len).map_err(failed)?,
            memory: stream.alloc_zeros(1).map_err(failed)?,
            feed: stream.alloc_zeros(1 + n).map_err(failed)?,
            graphs: [None, None],
            reward_scale,
            stream,
            gpu,
        })
    }

    fn launch(&self, launch: &Launch) -> Result<(), Error> {
        let Self { gpu: Gpu { kernels, .. }, stream, arena, memory, feed, reward_scale, .. } = self;
        let (all, moved, networks, rate, follows);
        let (mut call, blocks, threads);
        match launch {
            Launch::Gather(gather) => {
                blocks = (gather.n * (2 * gather.observation + gather.action + 2)).div_ceil(THREADS);
                threads = THREADS;
                call = stream.launch_builder(&kernels.gather);
                call.arg(arena).arg(memory).arg(feed).arg(gather).arg(reward_scale);
            }
            Launch::Products(mode, products) => {
                let size = size(products);
                (blocks, threads) = (TILES[size].count(products), TILES[size].threads[*mode as usize]);
                all = Products(filled(products));
                call = stream.launch_builder(&kernels.products[*mode as usize][size]);
                call.arg(arena).arg(&all);
            }
            Launch::Losses(losses) => {
                (blocks, threads) = (1, LOSSES_THREADS);
                call = stream.launch_builder(&kernels.losses);
                call.arg(arena).arg(feed).arg(losses);
            }
            Launch::Sum(all) => {
                moved = AllMoved(filled(all));
                (blocks, threads) = (all.iter().map(Moved::blocks).sum(), THREADS);
                call = stream.launch_builder(&kernels.sum);
                call.arg(arena).arg(&moved);
            }
            Launch::Step(step) => {
                moved = AllMoved(filled(&step.moved));
                (networks, rate) = (step.moved.len() as u32, step.target_rate.unwrap_or(0.0));
                follows = u32::from(step.target_rate.is_some());
                (blocks, threads) = (step.moved.iter().map(Moved::blocks).sum(), THREADS);
                call = stream.launch_builder(&kernels.step);
                call.arg(arena).arg(feed).arg(&moved).arg(&networks).arg(&step.resting);
                call.arg(&step.report).arg(&step.clip).arg(&rate).arg(&follows);
            }
        }
        let shape = LaunchConfig { grid_dim: (blocks, 1, 1), block_dim: (threads, 1, 1), shared_mem_bytes: 0 };
        // SAFETY: the arguments are those that the kernel declares. Places in them lie in the arena, as `Plan` laid it
        // out. The feed holds an update's number, below as many as the arena has room for, then for each of n transitions
        // a slot, which `OnDevice::remember` has filled in the memory before.
        unsafe { call.launch(shape) }.map(|_| ()).map_err(failed)
    }
}

impl Machine for Cuda {
    fn write(&mut self, at: u32, numbers: &[f32]) -> Result<(), Error> {
        let at = at as usize;
        self.stream.memcpy_htod(numbers, &mut self.arena.slice_mut(at..at + numbers.len())).map_err(failed)
    }

    fn read(&self, at: u32, count: usize) -> Result<Vec<f32>, Error> {
        let at = at as usize;
        let numbers = self.stream.clone_dtoh(&self.arena.slice(at..at + count)).map_err(failed)?;
        self.stream.synchronize().map_err(failed)?;
        Ok(numbers)
    }

    fn make_room(&mut self, numbers: usize) -> Result<(), Error> {
        if self.memory.len() >= numbers {
            return Ok(());
        }
        // Graphs hold the old one's address. It goes first: there may be no room for both.
        self.graphs = [None, None];
        self.memory = self.stream.alloc_zeros(1).map_err(failed)?;
        self.memory = self.stream.alloc_zeros(numbers).map_err(|error| {
            Error::GpuFailed(format!("no room for {numbers} numbers of the replay memory: {error}"))
        })?;
        Ok(())
    }

    fn remember(&mut self, at: usize, numbers: &[f32]) -> Result<(), Error> {
        self.stream.memcpy_htod(numbers, &mut self.memory.slice_mut(at..at + numbers.len())).map_err(failed)
    }

    fn run(&mut self, number: usize, program: &[Launch], feed: &[u32]) -> Result<(), Error> {
        self.stream.memcpy_htod(feed, &mut self.feed).map_err(failed)?;
        if let Some(graph) = &self.graphs[number] {
            return graph.0.launch().map_err(failed);
        }
        // The first time as they are: a kernel must not be loaded while a graph is captured.
        program.iter().try_for_each(|launch| self.launch(launch))?;
        self.stream.begin_capture(CUstreamCaptureMode::CU_STREAM_CAPTURE_MODE_THREAD_LOCAL).map_err(failed)?;
        let launched = program.iter().try_for_each(|launch| self.launch(launch));
        let graph = self.stream.end_capture(CUgraphInstantiate_flags(0));
        launched?;
        self.graphs[number] = graph.map_err(failed)?.map(Graph);
        Ok(())
    }
}

impl Debug for Cuda {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let Self { arena, memory, .. } = self;
        f.debug_struct("Cuda").field("arena", &arena.len()).field("memory", &memory.len()).finish_non_exhaustive()
    }
}

/// The size of tiles for these products: medium, if there are enough of them and most are full.
fn size(products: &[Product]) -> usize {
    let [small, medium] = TILES.map(|tile| tile.count(products));
    usize::from(medium >= ENOUGH_TILES && small >= 3 * medium)
}

/// So many of them; what is beyond the last is never looked at.
fn filled<T: Copy, const N: usize>(items: &[T]) -> [T; N] {
    std::array::from_fn(|i| items[i.min(items.len() - 1)])
}

fn text(error: impl Display) -> String {
    error.to_string()
}

fn failed(error: impl Display) -> Error {
    Error::GpuFailed(text(error))
}
