//! Which splats each tile sees, front to back: the constant part of rendering a frame.

use super::bucket;
use super::project::{self, Projection, RawSplats, View};
use super::rules::{Rules, SortKey, Stop};
use super::tile_grid::{TileGrid, pixel_workgroups, stride, workgroups};
use crate::error::KernelError;
use crate::registry::splat::{
    rasterize_visit, rasterize_visit_tile, tile_bin_active, tile_bin_count, tile_bin_emit, tile_bin_keep,
    tile_bin_order, tile_bin_pairs, tile_bin_ranges, tile_bin_splats, tile_bin_tiles,
};
use crate::scan::prefix_sum;
use crate::scan::radix_sort::{self, SortPairs};
use crate::shape::dim;
use crate::vk::{Buffer, Device, Grid, KernelFamily, PassTime, Recorder, Timings};

const KERNEL: &str = "splat/tile_bin";

/// Tiles that one invocation walks at most, below lavapipe's loop limit of 65,535.
const MAX_BAND_TILES: u32 = 32_768;
/// Pairs of one tile at most: 8 in each of lavapipe's 65,535 turns of a loop.
const MAX_TILE_PAIRS: usize = 8 * 65_535;
/// Extra list entries, so that a lane beside the last pair still reads inside the buffer.
const LIST_PADDING: usize = 8;

/// What happens to pairs that change no pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Prune {
    /// They stay: one traversal less to build, for frames that are rendered once.
    Keep,
    /// They go, and splats without pairs with them; images and gradients stay the same to the bit.
    Remove,
}

/// A view's visible splats in the order of the scene, and for each tile its splats front to back.
#[derive(Debug)]
pub struct VisibleLists {
    /// Image and tiles.
    pub grid: TileGrid,
    /// How the splats are drawn.
    pub rules: Rules,
    /// V.
    pub num_visible: usize,
    /// I, pairs of a tile and a splat.
    pub num_isects: usize,
    /// Tiles that a splat may reach; the others show the background.
    pub num_active: usize,
    /// Centre, scaled conic, opacity, depth, exponent of base 2 that still counts `[V,8]`.
    pub geom: Buffer<f32>,
    /// Unit vectors from the camera `[V,4]`.
    pub dirs: Buffer<f32>,
    /// Row in the scene of each visible splat `[V]`.
    pub splat_from_visible: Buffer<u32>,
    /// First pair of each tile `[tiles+1]`.
    pub tile_offsets: Buffer<u32>,
    /// Visible splat of each pair, by tile and depth `[I]`; see [`Self::is_packed`].
    pub(super) splat_from_isect: Buffer<u32>,
    /// Slot of each pair: a splat's slots are contiguous `[I]`; empty where pairs are packed.
    pub(super) slot_from_isect: Buffer<u32>,
    /// First slot and end of each visible splat `[V,2]`.
    pub slot_ranges: Buffer<u32>,
    /// All tiles, the active ones first `[tiles]`.
    pub tile_order: Buffer<u32>,
}

impl VisibleLists {
    /// Lists for passes of `rec`.
    fn new(
        rec: &mut Recorder,
        job: Job,
        num_visible: usize,
        num_isects: usize,
        num_active: usize,
    ) -> Result<Self, KernelError> {
        let grid = job.grid;
        let isects = num_isects + LIST_PADDING;
        let slots = if is_packed(num_visible, grid) { 0 } else { isects };
        Ok(Self {
            grid,
            rules: job.rules,
            num_visible,
            num_isects,
            num_active,
            geom: rec.zeros("lists.geom", 8 * num_visible)?,
            dirs: rec.zeros("lists.dirs", 4 * num_visible)?,
            splat_from_visible: rec.zeros("lists.splat_from_visible", num_visible)?,
            tile_offsets: rec.zeros("lists.tile_offsets", grid.num_tiles() as usize + 1)?,
            splat_from_isect: rec.zeros("lists.splat_from_isect", isects)?,
            slot_from_isect: rec.zeros("lists.slot_from_isect", slots)?,
            slot_ranges: rec.zeros("lists.slot_ranges", 2 * num_visible)?,
            tile_order: rec.zeros("lists.tile_order", grid.num_tiles() as usize)?,
        })
    }

    /// Whether a word of 32 bits holds a pair: its splat in the lower half, in the upper one the place of its slot
    /// among those of the splat.
    #[must_use]
    pub fn is_packed(&self) -> bool {
        is_packed(self.num_visible, self.grid)
    }

    /// Visible splat and slot of each pair, by tile and depth, read back.
    ///
    /// # Errors
    /// When the device fails.
    pub fn pairs(&self) -> Result<Vec<[u32; 2]>, KernelError> {
        let words = self.splat_from_isect.read_range(0..self.num_isects)?;
        if !self.is_packed() {
            let slots = self.slot_from_isect.read_range(0..self.num_isects)?;
            return Ok(words.into_iter().zip(slots).map(|(splat, slot)| [splat, slot]).collect());
        }
        let ranges = self.slot_ranges.read()?;
        let pair = |word: u32| [word & 0xffff, ranges[2 * (word & 0xffff) as usize] + (word >> 16)];
        Ok(words.into_iter().map(pair).collect())
    }

    /// Bytes of device memory.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let floats = self.geom.len() + self.dirs.len();
        let indices = self.splat_from_visible.len()
            + self.tile_offsets.len()
            + self.splat_from_isect.len()
            + self.slot_from_isect.len()
            + self.slot_ranges.len()
            + self.tile_order.len();
        4 * (floats + indices)
    }
}

/// Whether 16 bits hold every visible splat, and the place of a pair among those of its splat: it has one for each tile
/// at most.
fn is_packed(num_visible: usize, grid: TileGrid) -> bool {
    const VALUES: usize = 1 << 16;
    num_visible <= VALUES && grid.num_tiles() as usize <= VALUES
}

/// Working memory that grows with the number of pairs.
#[derive(Debug)]
struct PairScratch {
    sort: SortPairs,
    splat_from_slot: Buffer<u32>,
    kept_isects: Buffer<u32>,
    kept_slots: Buffer<u32>,
}

impl PairScratch {
    fn new(device: &Device, pairs: usize) -> Result<Self, KernelError> {
        let sums = (pairs + 1).next_multiple_of(4);
        Ok(Self {
            sort: SortPairs::new(device, "tile_bin.pairs", pairs + LIST_PADDING)?,
            splat_from_slot: device.buffer("tile_bin.splat_from_slot", pairs.max(1))?,
            kept_isects: device.buffer("tile_bin.kept_isects", sums)?,
            kept_slots: device.buffer("tile_bin.kept_slots", sums)?,
        })
    }
}

/// Working memory that grows with the number of splats.
#[derive(Debug)]
struct SplatScratch {
    projection: Projection,
    slot_offsets: Buffer<u32>,
    visible: Buffer<u32>,
}

impl SplatScratch {
    fn new(device: &Device, n: usize, bands: usize) -> Result<Self, KernelError> {
        let sums = |n: usize| (n + 1).next_multiple_of(4);
        Ok(Self {
            projection: Projection::new(device, n)?,
            slot_offsets: device.buffer("tile_bin.slot_offsets", sums(n * bands))?,
            visible: device.buffer("tile_bin.visible", sums(n))?,
        })
    }
}

/// Working memory of one tile grid.
#[derive(Debug)]
struct TileScratch {
    offsets: Buffer<u32>,
    active: Buffer<u32>,
    order: Buffer<u32>,
}

impl TileScratch {
    fn new(device: &Device, tiles: usize) -> Result<Self, KernelError> {
        Ok(Self {
            offsets: device.buffer("tile_bin.tile_offsets", tiles + 1)?,
            active: device.buffer("tile_bin.active_tiles", (tiles + 1).next_multiple_of(4))?,
            order: device.buffer("tile_bin.tile_order", tiles)?,
        })
    }
}

/// One frame to bin.
#[derive(Clone, Copy, Debug)]
struct Job {
    n: usize,
    grid: TileGrid,
    rules: Rules,
    bands: u32,
    band_rows: u32,
}

impl Job {
    fn new(view: &View, n: usize) -> Result<Self, KernelError> {
        let grid = TileGrid::new(view.width, view.height)?;
        let band_rows = (MAX_BAND_TILES / grid.tiles_x()).clamp(1, grid.tiles_y());
        Ok(Self { n, grid, rules: view.rules, bands: grid.tiles_y().div_ceil(band_rows), band_rows })
    }

    fn counts(&self) -> usize {
        self.n * self.bands as usize
    }
}

/// Builds [`VisibleLists`]; keeps its working memory between frames.
#[derive(Debug)]
pub struct TileBinner {
    device: Device,
    splats: Option<SplatScratch>,
    pairs: Option<PairScratch>,
    tiles: Option<TileScratch>,
    scan: prefix_sum::Scratch,
    /// What the host waits for between two stages.
    found: Buffer<u32>,
}

impl TileBinner {
    /// A binner without working memory yet.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(device: &Device) -> Result<Self, KernelError> {
        let scan = prefix_sum::Scratch::new(device, "tile_bin")?;
        let found = device.readback("tile_bin.found", 4)?;
        Ok(Self { device: device.clone(), splats: None, pairs: None, tiles: None, scan, found })
    }

    /// Projects, sorts and bins the splats of one view; runs at once and waits. Rules that sort by buckets need those.
    ///
    /// # Shapes
    /// in `splats` \[N,4\] each
    /// # Equation
    /// The tile lists of Kerbl et al. 2023: a splat is seen only in the 16 x 16 tiles of its 3-sigma
    /// square, unless the rules of the view say otherwise; pairs are sorted by tile and view depth or distance, ties
    /// by index. Lists are held for 8 x 8 tiles, without the tiles where alpha stays below the threshold.
    /// # Determinism: bitwise; no atomics
    ///
    /// # Errors
    /// [`KernelError::Shape`] for wrong lengths, an image with too many tiles, or a tile with more
    /// pairs than a kernel may walk.
    pub fn build(
        &mut self,
        view: &View,
        splats: RawSplats<'_>,
        n: usize,
        prune: Prune,
    ) -> Result<(VisibleLists, Timings), KernelError> {
        let job = Job::new(view, n)?;
        let mut passes = Vec::new();
        let total = if n == 0 { 0 } else { self.count(view, splats, job, &mut passes)? };
        if total == 0 {
            return Ok((empty(&self.device, job)?, Timings { passes }));
        }
        let num_active = self.emit(job, total, &mut passes)?;
        let (num_visible, num_isects) = self.select(job, total, prune, num_active, &mut passes)?;
        let mut rec = self.device.recorder()?;
        let mut lists = VisibleLists::new(&mut rec, job, num_visible, num_isects, num_active)?;
        self.compact(&mut rec, job, total, &mut lists)?;
        passes.extend(rec.submit()?.passes);
        Ok((lists, Timings { passes }))
    }

    /// Projects, sorts by depth and counts pairs.
    fn count(
        &mut self,
        view: &View,
        splats: RawSplats<'_>,
        job: Job,
        passes: &mut Vec<PassTime>,
    ) -> Result<usize, KernelError> {
        let fits = |s: &SplatScratch| s.visible.len() > job.n && s.slot_offsets.len() > job.counts();
        let scratch = match self.splats.take() {
            Some(scratch) if fits(&scratch) => scratch,
            _ => SplatScratch::new(&self.device, job.n, job.bands as usize)?,
        };
        let scratch = self.splats.insert(scratch);
        let mut rec = self.device.recorder()?;
        let projection = &mut scratch.projection;
        project::forward(&mut rec, view, splats, job.n, projection)?;
        let bits = match (job.rules.sort_key, splats.buckets) {
            (SortKey::Depth | SortKey::Distance, _) => u32::BITS,
            (SortKey::Buckets, Some(buckets)) => {
                bucket::forward(&mut rec, view, buckets, job.n, projection)?;
                bucket::key_bits(job.n)
            }
            (SortKey::Buckets, None) => {
                let (got, expected) = ("none".to_owned(), format!("[{}], as the rules sort by them", job.n));
                return Err(KernelError::Shape { kernel: KERNEL, buffer: "buckets", got, expected });
            }
        };
        radix_sort::sort(&mut rec, &mut projection.order, job.n, bits)?;
        let bind = tile_bin_count::Bind {
            geom: &projection.geom,
            tile_rects: &projection.tile_rects,
            order: &projection.order.values,
            counts: &mut scratch.slot_offsets,
        };
        let params = tile_bin_count::Params { n: dim(job.n), bands: job.bands, band_rows: job.band_rows };
        rec.dispatch(bind, params, Grid::threads(job.counts()))?;
        prefix_sum::exclusive(&mut rec, &mut scratch.slot_offsets, job.counts(), &mut self.scan)?;
        rec.copy(&scratch.slot_offsets, job.counts(), &mut self.found, 0, 1)?;
        passes.extend(rec.submit()?.passes);
        self.first_found()
    }

    /// Writes the pairs, sorts them by tile and finds where each tile begins; returns the number of active tiles.
    fn emit(&mut self, job: Job, total: usize, passes: &mut Vec<PassTime>) -> Result<usize, KernelError> {
        let pairs = match self.pairs.take() {
            Some(pairs) if pairs.splat_from_slot.len() >= total => pairs,
            _ => PairScratch::new(&self.device, total)?,
        };
        let pairs = self.pairs.insert(pairs);
        let num_tiles = job.grid.num_tiles();
        let tiles = match self.tiles.take() {
            Some(tiles) if tiles.order.len() == num_tiles as usize => tiles,
            _ => TileScratch::new(&self.device, num_tiles as usize)?,
        };
        let tiles = self.tiles.insert(tiles);
        let scratch = self.splats.as_ref().expect("count has filled it");
        let mut rec = self.device.recorder()?;
        let bind = tile_bin_emit::Bind {
            geom: &scratch.projection.geom,
            tile_rects: &scratch.projection.tile_rects,
            order: &scratch.projection.order.values,
            slot_offsets: &scratch.slot_offsets,
            tile_keys: &mut pairs.sort.keys,
            slots: &mut pairs.sort.values,
            splat_from_slot: &mut pairs.splat_from_slot,
        };
        let params = tile_bin_emit::Params {
            n: dim(job.n),
            bands: job.bands,
            band_rows: job.band_rows,
            tiles_x: job.grid.tiles_x(),
        };
        rec.dispatch(bind, params, Grid::threads(job.counts()))?;
        let bits = u32::BITS - (num_tiles - 1).leading_zeros();
        radix_sort::sort(&mut rec, &mut pairs.sort, total, bits.max(1))?;
        order_tiles(&mut rec, &pairs.sort.keys, total, tiles, &mut self.scan)?;
        rec.copy(&tiles.active, num_tiles as usize, &mut self.found, 0, 1)?;
        passes.extend(rec.submit()?.passes);
        if job.n > MAX_TILE_PAIRS {
            longest_list_fits(&tiles.offsets)?;
        }
        self.first_found()
    }

    /// The number that the last submission left for the host.
    fn first_found(&self) -> Result<usize, KernelError> {
        Ok(self.found.read_range(0..1)?[0] as usize)
    }

    /// Decides which pairs and splats stay; returns V and I.
    fn select(
        &mut self,
        job: Job,
        total: usize,
        prune: Prune,
        num_active: usize,
        passes: &mut Vec<PassTime>,
    ) -> Result<(usize, usize), KernelError> {
        let scratch = self.splats.as_mut().expect("count has filled it");
        let pairs = self.pairs.as_mut().expect("emit has filled it");
        let tiles = self.tiles.as_ref().expect("emit has filled it");
        let mut rec = self.device.recorder()?;
        match prune {
            Prune::Keep => {
                rec.fill(&mut pairs.kept_isects, 1);
                rec.fill(&mut pairs.kept_slots, 1);
            }
            Prune::Remove => visit(&mut rec, job, num_active, &scratch.projection, pairs, tiles)?,
        }
        prefix_sum::exclusive(&mut rec, &mut pairs.kept_isects, total, &mut self.scan)?;
        prefix_sum::exclusive(&mut rec, &mut pairs.kept_slots, total, &mut self.scan)?;
        let bind = tile_bin_keep::Bind {
            slot_offsets: &scratch.slot_offsets,
            kept_slots: &pairs.kept_slots,
            order: &scratch.projection.order.values,
            visible: &mut scratch.visible,
        };
        let params = tile_bin_keep::Params { n: dim(job.n), bands: job.bands };
        rec.dispatch(bind, params, Grid::threads(job.n))?;
        prefix_sum::exclusive(&mut rec, &mut scratch.visible, job.n, &mut self.scan)?;
        rec.copy(&scratch.visible, job.n, &mut self.found, 0, 1)?;
        rec.copy(&pairs.kept_isects, total, &mut self.found, 1, 1)?;
        passes.extend(rec.submit()?.passes);
        let found = self.found.read_range(0..2)?;
        Ok((found[0] as usize, found[1] as usize))
    }

    /// Gathers what stays.
    fn compact(&self, rec: &mut Recorder, job: Job, total: usize, lists: &mut VisibleLists) -> Result<(), KernelError> {
        let scratch = self.splats.as_ref().expect("count has filled it");
        let pairs = self.pairs.as_ref().expect("emit has filled it");
        let tiles = self.tiles.as_ref().expect("emit has filled it");
        let bind = tile_bin_splats::Bind {
            geom: &scratch.projection.geom,
            dirs: &scratch.projection.dirs,
            order: &scratch.projection.order.values,
            visible: &scratch.visible,
            slot_offsets: &scratch.slot_offsets,
            kept_slots: &pairs.kept_slots,
            visible_geom: &mut lists.geom,
            visible_dirs: &mut lists.dirs,
            splat_from_visible: &mut lists.splat_from_visible,
            slot_ranges: &mut lists.slot_ranges,
        };
        let params = tile_bin_splats::Params { n: dim(job.n), bands: job.bands };
        rec.dispatch(bind, params, Grid::threads(job.n))?;
        let bind = tile_bin_pairs::Bind {
            slots: &pairs.sort.values,
            splat_from_slot: &pairs.splat_from_slot,
            visible: &scratch.visible,
            kept_isects: &pairs.kept_isects,
            kept_slots: &pairs.kept_slots,
            slot_ranges: &lists.slot_ranges,
            splat_from_isect: &mut lists.splat_from_isect,
            slot_from_isect: &mut lists.slot_from_isect,
        };
        let params = tile_bin_pairs::Params { num_isects: dim(total) };
        let spec = tile_bin_pairs::Spec { packed: u32::from(is_packed(lists.num_visible, lists.grid)) };
        rec.dispatch_spec(bind, params, spec, Grid::threads(total))?;
        let bind = tile_bin_tiles::Bind {
            tile_offsets: &tiles.offsets,
            kept_isects: &pairs.kept_isects,
            kept_tile_offsets: &mut lists.tile_offsets,
        };
        let num_tiles = job.grid.num_tiles();
        rec.dispatch(bind, tile_bin_tiles::Params { num_tiles }, Grid::threads(num_tiles as usize + 1))?;
        rec.copy(&tiles.order, 0, &mut lists.tile_order, 0, num_tiles as usize)
    }
}

/// Lists of a view that sees nothing.
fn empty(device: &Device, job: Job) -> Result<VisibleLists, KernelError> {
    let mut rec = device.recorder()?;
    let mut lists = VisibleLists::new(&mut rec, job, 0, 0, 0)?;
    rec.submit()?;
    let order: Vec<u32> = (0..job.grid.num_tiles()).collect();
    lists.tile_order.write(&order)?;
    Ok(lists)
}

/// Finds where each tile begins in the sorted pairs and puts the tiles that have pairs first.
fn order_tiles(
    rec: &mut Recorder,
    tile_keys: &Buffer<u32>,
    total: usize,
    tiles: &mut TileScratch,
    scan: &mut prefix_sum::Scratch,
) -> Result<(), KernelError> {
    let count = tiles.order.len();
    let num_tiles = dim(count);
    let bind = tile_bin_ranges::Bind { tile_keys, tile_offsets: &mut tiles.offsets };
    let params = tile_bin_ranges::Params { num_tiles, num_isects: dim(total) };
    rec.dispatch(bind, params, Grid::threads(count + 1))?;
    let bind = tile_bin_active::Bind { tile_offsets: &tiles.offsets, active_tiles: &mut tiles.active };
    rec.dispatch(bind, tile_bin_active::Params { num_tiles }, Grid::threads(count))?;
    prefix_sum::exclusive(rec, &mut tiles.active, count, scan)?;
    let bind = tile_bin_order::Bind { active_tiles: &tiles.active, tile_order: &mut tiles.order };
    rec.dispatch(bind, tile_bin_order::Params { num_tiles }, Grid::threads(count))
}

/// Marks the pairs that reach a pixel which has not stopped.
fn visit(
    rec: &mut Recorder,
    job: Job,
    num_active: usize,
    projection: &Projection,
    pairs: &mut PairScratch,
    tiles: &TileScratch,
) -> Result<(), KernelError> {
    let Job { grid, rules, .. } = job;
    /// Binds and runs the program of one family; only the module that the types come from differs.
    macro_rules! visit {
        ($module:ident, $grid:expr) => {{
            let bind = $module::Bind {
                geom: &projection.geom,
                slot_from_isect: &pairs.sort.values,
                splat_from_slot: &pairs.splat_from_slot,
                tile_offsets: &tiles.offsets,
                tile_order: &tiles.order,
                kept_isect: &mut pairs.kept_isects,
                kept_slot: &mut pairs.kept_slots,
            };
            let params = $module::Params {
                width: grid.width,
                height: grid.height,
                tiles_x: grid.tiles_x(),
                num_active: dim(num_active),
                tile_stride: stride(num_active),
                min_alpha: rules.min_alpha,
                max_alpha: rules.max_alpha,
                span: rules.span(),
                foot: rules.foot,
                behind: u32::from(rules.stop == Stop::Behind),
            };
            rec.dispatch_spec(bind, params, $module::Spec { plain: rules.plain() }, $grid)
        }};
    }
    match rec.family() {
        KernelFamily::Lanes => visit!(rasterize_visit, workgroups(num_active)),
        KernelFamily::Tiles => visit!(rasterize_visit_tile, pixel_workgroups(num_active)),
    }
}

fn longest_list_fits(tile_offsets: &Buffer<u32>) -> Result<(), KernelError> {
    let offsets = tile_offsets.read()?;
    let longest = offsets.windows(2).map(|w| (w[1] - w[0]) as usize).max().unwrap_or(0);
    if longest <= MAX_TILE_PAIRS {
        return Ok(());
    }
    Err(KernelError::Shape {
        kernel: KERNEL,
        buffer: "tile_offsets",
        got: format!("{longest} splats in one tile"),
        expected: format!("at most {MAX_TILE_PAIRS}"),
    })
}
