//! The one pass over all points.

use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, Result};
use rayon::prelude::*;
use tieline_io::las::Columns;
use tieline_matching::xyz::texture::TexturePoints;
use tieline_matching::xyz::{PostPoints, TileKeeper, TilePoints};
use tieline_matching::{Accumulator, BinSketch, PassCounts, Run, Sketches, SourceKey};

use crate::progress::Progress;
use crate::sample::block;
use crate::settings::Settings;
use crate::stage::nearby::{Keeping, Nearby};
use crate::stage::places::keep::{SubmapPoints, keep};
use crate::survey::Survey;

/// What the pass gives.
#[derive(Debug)]
pub struct Scan {
    /// Sorted runs of cells.
    pub runs: Vec<Run>,
    /// Sketches by source and time.
    pub sketches: Vec<((SourceKey, i64), BinSketch)>,
    /// Counts.
    pub counts: PassCounts,
    /// Points of pavement, where they are asked for.
    pub pavement: Option<TexturePoints>,
    /// Points beside the road, where posts are asked for.
    pub posts: Option<PostPoints>,
    /// Points of submaps, where they are asked for.
    pub submaps: Option<TilePoints>,
}

/// What a thread has: cells, points near a vehicle, points of submaps.
type OfThread<'a> = (Accumulator, Option<Keeping<'a>>, Option<TileKeeper>);

const TEMPORARY: &str = "a temporary file for patches cannot be written; free the disk or set TMPDIR";

/// Reads every point once, on all threads: each takes the next chunk, decodes it and adds it to its own sums; those `nearby`, and of
/// `submaps`, are kept.
///
/// # Errors
/// The first chunk that cannot be read, with its file.
pub fn scan(
    survey: &Survey,
    settings: &Settings,
    nearby: Option<&Nearby<'_>>,
    submaps: Option<&SubmapPoints>,
    progress: &Progress,
) -> Result<Scan> {
    let tasks: Vec<(usize, usize)> = survey
        .files
        .iter()
        .enumerate()
        .flat_map(|(f, file)| (0..file.las.chunk_count()).map(move |c| (f, c)))
        .collect();
    let next = AtomicUsize::new(0);
    let threads = rayon::current_num_threads();
    let total: u64 = survey.files.iter().map(|f| f.las.header().point_count).sum();
    let bar = progress.bar("reading points", total);
    let parts: Vec<Result<OfThread<'_>>> = (0..threads)
        .into_par_iter()
        .with_max_len(1)
        .map(|_| {
            let mut accumulator = Accumulator::new(settings.grid.clone());
            let mut keeping = nearby.map(Nearby::keeping);
            let mut keeper = submaps.map(SubmapPoints::keeper);
            let (mut records, mut columns, mut zeros) = (Vec::new(), Columns::default(), Vec::new());
            while let Some((f, chunk)) = tasks.get(next.fetch_add(1, Ordering::Relaxed)) {
                let file = &survey.files[*f];
                file.las.read_columns(*chunk, &mut records, &mut columns)?;
                zeros.resize(columns.len(), 0.0);
                let points = file.las.chunk_points(*chunk);
                let block = block(file, &columns, &zeros, points.start);
                accumulator.add(&block).context(TEMPORARY)?;
                if let Some(keeping) = &mut keeping {
                    keeping.add(&block, &settings.grid).context(TEMPORARY)?;
                }
                if let Some(keeper) = &mut keeper {
                    keep(keeper, &block, settings).context(TEMPORARY)?;
                }
                bar.inc(points.end - points.start);
            }
            Ok((accumulator, keeping, keeper))
        })
        .collect();
    bar.finish();
    let mut scan = Scan {
        runs: Vec::new(),
        sketches: Vec::new(),
        counts: PassCounts::default(),
        pavement: None,
        posts: None,
        submaps: None,
    };
    let (mut pavement, mut posts, mut tile_keepers) = (Vec::new(), Vec::new(), Vec::new());
    let mut sketches = Sketches::default();
    for part in parts {
        let (accumulator, keeping, keeper) = part?;
        let kept = keeping.map(Keeping::finish).unwrap_or_default();
        pavement.extend(kept.0);
        posts.extend(kept.1);
        tile_keepers.extend(keeper);
        let (runs, of_thread, counts) = accumulator.finish();
        scan.runs.extend(runs);
        sketches.merge(of_thread);
        scan.counts.merge(&counts);
    }
    scan.sketches = sketches.into_sorted();
    scan.pavement = (!pavement.is_empty()).then(|| TexturePoints::new(pavement));
    scan.posts = (!posts.is_empty()).then(|| PostPoints::new(posts));
    scan.submaps = submaps.map(|s| TilePoints::new(s.choice, tile_keepers));
    Ok(scan)
}
