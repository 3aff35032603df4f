//! Factorisation with the panels on disk.
//!
//! The tree is cut into groups: subtrees whose panels fit a budget, and single blocks above them. A group is worked
//! through in memory and written as one file: panels, its part of the right-hand side, and what it hands up, with a
//! fingerprint of the equations in front and a checksum behind. A file appears under its name only when it is whole,
//! so a run that was killed takes up after the last whole file.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use super::block::{Equations, Pool, Singular, Update, right_start};
use super::factor::backward_block;
use super::tree::{NONE, Tree};

/// Where and in what pieces panels are kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Disk {
    /// Folder of the block files; must exist.
    pub folder: PathBuf,
    /// Most bytes of panels that are in memory at once, the largest block apart.
    pub group_bytes: usize,
}

/// What goes wrong with block files.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DiskError {
    /// A file cannot be written.
    #[error("writing the block file {path}: {source}; free some space, or name a folder on another disk")]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A file cannot be read.
    #[error("reading the block file {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A file is not what was written.
    #[error("the block file {path} is damaged: its checksum does not fit; delete it and run again")]
    Damaged {
        /// The file.
        path: PathBuf,
    },
}

const MAGIC: u64 = 0x5449_454c_484d_5431;
const HEADER: usize = 4;
const HEADER_BYTES: usize = 8 * HEADER;

/// Blocks `first..=last` in one file.
#[derive(Debug, Clone, Copy)]
struct Group {
    first: usize,
    last: usize,
}

/// Panels on disk.
#[derive(Debug)]
pub struct DiskFactorisation {
    folder: PathBuf,
    groups: Vec<Group>,
    fingerprint: u64,
    /// Groups taken over from an earlier run.
    pub resumed: usize,
    cached: Mutex<Option<(usize, Vec<f64>)>>,
}

/// A running checksum of numbers in four lanes.
#[derive(Debug, Clone)]
struct Checksum([u64; 4]);

impl Checksum {
    fn new() -> Self {
        Self([0x9e37_79b9_7f4a_7c15, 0xc2b2_ae3d_27d4_eb4f, 0x1656_67b1_9e37_79f9, 0x27d4_eb2f_1656_67c5])
    }
    fn add(&mut self, numbers: &[f64]) {
        let mut chunks = numbers.chunks_exact(4);
        for chunk in &mut chunks {
            for (lane, value) in self.0.iter_mut().zip(chunk) {
                *lane = mix(*lane, value.to_bits());
            }
        }
        for value in chunks.remainder() {
            self.0[0] = mix(self.0[0], value.to_bits());
        }
    }
    fn value(&self) -> u64 {
        self.0.iter().fold(0, |sum, lane| mix(sum, *lane))
    }
}

fn mix(sum: u64, word: u64) -> u64 {
    (sum ^ word).wrapping_mul(0x9fb2_1c65_1e98_df25).rotate_left(29)
}

impl DiskFactorisation {
    /// Factorises with panels on disk and carries the right-hand side along.
    ///
    /// # Errors
    /// [`DiskError`]; the inner result is [`Singular`].
    pub fn factorise(
        disk: &Disk,
        equations: &Equations<'_>,
        right: &mut [f64],
    ) -> Result<Result<Self, Singular>, DiskError> {
        let tree = equations.tree;
        let groups = groups(tree, disk.group_bytes / 8);
        let mut this = Self {
            folder: disk.folder.clone(),
            groups,
            fingerprint: fingerprint(equations, right),
            resumed: 0,
            cached: Mutex::new(None),
        };
        let mut pool = Pool::default();
        let mut numbers = Vec::new();
        for index in 0..this.groups.len() {
            let group = this.groups[index];
            let (start, end) = scalar_range(tree, group);
            let own = &mut right[start..end];
            if this.take_over(tree, index, own) {
                this.resumed += 1;
                continue;
            }
            numbers.clear();
            numbers.resize(panel_len(tree, group), 0.0);
            let worked = if group.first == group.last {
                this.upper_block(equations, group.last, &mut numbers, own, &mut pool)?
            } else {
                work_through(equations, group, &mut numbers, own, &mut pool)
            };
            match worked {
                Ok(update) => {
                    this.write(index, &numbers, &right[start..end], &update)?;
                    pool.give(update);
                }
                Err(singular) => return Ok(Err(singular)),
            }
        }
        Ok(Ok(this))
    }

    /// `L⁻ᵀ right`, in place.
    ///
    /// # Errors
    /// [`DiskError`].
    pub fn backward(&self, tree: &Tree, right: &mut [f64]) -> Result<(), DiskError> {
        let (mut boundary, mut numbers) = (Vec::new(), Vec::new());
        for (index, group) in self.groups.iter().enumerate().rev() {
            self.read_panels(tree, index, &mut numbers)?;
            let base = tree.blocks[group.first].panel_start;
            for b in (group.first..=group.last).rev() {
                let block = &tree.blocks[b];
                let panel = &numbers[block.panel_start - base..block.panel_start - base + block.panel_len()];
                backward_block(tree, b, panel, right, &mut boundary);
            }
        }
        Ok(())
    }

    /// Panel of a block.
    ///
    /// # Errors
    /// [`DiskError`].
    pub fn panel(&self, tree: &Tree, block: usize) -> Result<Vec<f64>, DiskError> {
        let index = self.groups.partition_point(|g| g.last < block);
        let mut cached = self.cached.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if cached.as_ref().is_none_or(|(i, _)| *i != index) {
            let mut numbers = cached.take().map(|c| c.1).unwrap_or_default();
            self.read_panels(tree, index, &mut numbers)?;
            *cached = Some((index, numbers));
        }
        let base = tree.blocks[self.groups[index].first].panel_start;
        let b = &tree.blocks[block];
        let start = b.panel_start - base;
        Ok(cached.as_ref().map(|(_, n)| n[start..start + b.panel_len()].to_vec()).unwrap_or_default())
    }

    fn path(&self, index: usize) -> PathBuf {
        self.folder.join(format!("block-{index:05}.panel"))
    }

    /// Writes a group: beside its name first, then under it.
    fn write(&self, index: usize, panels: &[f64], right: &[f64], update: &Update) -> Result<(), DiskError> {
        let path = self.path(index);
        let beside = path.with_extension("part");
        let write = || -> std::io::Result<()> {
            let mut file = File::create(&beside)?;
            let header =
                [MAGIC, self.fingerprint, u64::try_from(index).unwrap_or(0), u64::try_from(panels.len()).unwrap_or(0)];
            file.write_all(bytemuck::cast_slice(&header))?;
            let mut sum = Checksum::new();
            for part in [panels, right, update.as_slice()] {
                sum.add(part);
                file.write_all(bytemuck::cast_slice(part))?;
            }
            file.write_all(&sum.value().to_le_bytes())?;
            drop(file);
            std::fs::rename(&beside, &path)
        };
        write().map_err(|source| {
            let _ = std::fs::remove_file(&beside);
            DiskError::Write { path, source }
        })
    }

    /// One block above the subtrees; what was handed up to it is read from their files, one after the other.
    fn upper_block(
        &self,
        equations: &Equations<'_>,
        block: usize,
        panel: &mut [f64],
        own: &mut [f64],
        pool: &mut Pool,
    ) -> Result<Result<Update, Singular>, DiskError> {
        let mut work = equations.open_block(block, panel, own, pool);
        for child in equations.tree.children(block) {
            let update = self.read_update(equations.tree, *child as usize)?;
            equations.add_child(&mut work, *child as usize, &update);
        }
        Ok(equations.close_block(work, pool))
    }

    /// Takes over what an earlier run wrote for a group, when the file is whole and of the same equations.
    fn take_over(&self, tree: &Tree, index: usize, right: &mut [f64]) -> bool {
        let group = self.groups[index];
        if !self.path(index).exists() {
            return false;
        }
        let mut numbers = Vec::new();
        if self.read_panels(tree, index, &mut numbers).is_err() {
            return false;
        }
        let mut own = vec![0.0; right.len()];
        let start = HEADER_BYTES + 8 * panel_len(tree, group);
        let mut read = || -> std::io::Result<()> {
            let mut file = File::open(self.path(index))?;
            file.seek(SeekFrom::Start(start as u64))?;
            file.read_exact(bytemuck::cast_slice_mut(&mut own))
        };
        if read().is_err() {
            return false;
        }
        right.copy_from_slice(&own);
        true
    }

    /// What the last block of a group hands up. The file was written or looked through in this run.
    fn read_update(&self, tree: &Tree, block: usize) -> Result<Update, DiskError> {
        let index = self.groups.partition_point(|g| g.last < block);
        let path = self.path(index);
        let group = self.groups[index];
        let (start, end) = scalar_range(tree, group);
        let count = tree.blocks[block].boundary_scalars;
        let mut update = vec![0.0; right_start(count) + count];
        let at = HEADER_BYTES + 8 * (panel_len(tree, group) + end - start);
        let mut read = || -> std::io::Result<()> {
            let mut file = File::open(&path)?;
            file.seek(SeekFrom::Start(at as u64))?;
            file.read_exact(bytemuck::cast_slice_mut(&mut update))
        };
        match read() {
            Ok(()) => Ok(update),
            Err(source) => Err(DiskError::Read { path, source }),
        }
    }

    fn check_header(&self, file: &mut File, index: usize) -> Option<()> {
        let mut header = [0_u64; HEADER];
        file.read_exact(bytemuck::cast_slice_mut(&mut header)).ok()?;
        let right = header[0] == MAGIC && header[1] == self.fingerprint && header[2] == u64::try_from(index).ok()?;
        right.then_some(())
    }

    /// Panels of a group; the checksum of the whole file is looked at.
    fn read_panels(&self, tree: &Tree, index: usize, numbers: &mut Vec<f64>) -> Result<(), DiskError> {
        let path = self.path(index);
        let group = self.groups[index];
        let read = |source| DiskError::Read { path: path.clone(), source };
        let mut file = File::open(&path).map_err(read)?;
        let damaged = || DiskError::Damaged { path: path.clone() };
        self.check_header(&mut file, index).ok_or_else(damaged)?;
        let mut sum = Checksum::new();
        numbers.clear();
        numbers.resize(panel_len(tree, group), 0.0);
        read_into(&mut file, numbers, &mut sum).map_err(read)?;
        let (start, end) = scalar_range(tree, group);
        let count = tree.blocks[group.last].boundary_scalars;
        let mut buffer = vec![0.0; 1 << 16];
        for len in [end - start, right_start(count) + count] {
            let mut left = len;
            while left > 0 {
                // whole pieces but the last one, as the lanes of the checksum ask
                let n = left.min(buffer.len());
                read_into(&mut file, &mut buffer[..n], &mut sum).map_err(read)?;
                left -= n;
            }
        }
        if read_word(&mut file).ok_or_else(damaged)? == sum.value() { Ok(()) } else { Err(damaged()) }
    }

    /// Deletes the block files.
    pub fn delete(&self) {
        for index in 0..self.groups.len() {
            let _ = std::fs::remove_file(self.path(index));
        }
    }
}

fn read_word(file: &mut File) -> Option<u64> {
    let mut bytes = [0; 8];
    file.read_exact(&mut bytes).ok()?;
    Some(u64::from_le_bytes(bytes))
}

fn read_into(file: &mut File, numbers: &mut [f64], sum: &mut Checksum) -> std::io::Result<()> {
    file.read_exact(bytemuck::cast_slice_mut(numbers))?;
    sum.add(numbers);
    Ok(())
}

/// Subtrees whose panels fit, and single blocks.
fn groups(tree: &Tree, numbers: usize) -> Vec<Group> {
    let fits = |b: usize| {
        let first = &tree.blocks[tree.blocks[b].subtree as usize];
        tree.blocks[b].panel_start + tree.blocks[b].panel_len() - first.panel_start <= numbers
    };
    let mut groups = Vec::new();
    for b in 0..tree.blocks.len() {
        let parent = tree.blocks[b].parent;
        if fits(b) {
            if parent == NONE || !fits(parent as usize) {
                groups.push(Group { first: tree.blocks[b].subtree as usize, last: b });
            }
        } else {
            groups.push(Group { first: b, last: b });
        }
    }
    groups
}

fn panel_len(tree: &Tree, group: Group) -> usize {
    let (first, last) = (&tree.blocks[group.first], &tree.blocks[group.last]);
    last.panel_start + last.panel_len() - first.panel_start
}

fn scalar_range(tree: &Tree, group: Group) -> (usize, usize) {
    let scalar = |p: u32| tree.scalar_start[p as usize] as usize;
    (scalar(tree.blocks[group.first].first), scalar(tree.blocks[group.last].end))
}

fn work_through(
    equations: &Equations<'_>,
    group: Group,
    mut panels: &mut [f64],
    mut right: &mut [f64],
    pool: &mut Pool,
) -> Result<Update, Singular> {
    let tree = equations.tree;
    let mut open: Vec<(u32, Update)> = Vec::new();
    for index in group.first..=group.last {
        let block = &tree.blocks[index];
        let (panel, p_rest) = std::mem::take(&mut panels).split_at_mut(block.panel_len());
        let (own, r_rest) = std::mem::take(&mut right).split_at_mut(block.own_scalars);
        (panels, right) = (p_rest, r_rest);
        let below = open.split_off(open.len() - tree.children(index).len());
        let update = equations.eliminate_block(index, panel, own, &below, pool)?;
        below.into_iter().for_each(|(_, buffer)| pool.give(buffer));
        open.push((u32::try_from(index).unwrap_or(u32::MAX), update));
    }
    Ok(open.pop().map(|o| o.1).unwrap_or_default())
}

/// What tells these equations from others.
#[allow(clippy::cast_precision_loss)]
fn fingerprint(equations: &Equations<'_>, right: &[f64]) -> u64 {
    let mut sum = Checksum::new();
    sum.add(equations.numbers);
    sum.add(right);
    let shape: Vec<f64> =
        equations.tree.blocks.iter().flat_map(|b| [b.own_scalars as f64, b.boundary_scalars as f64]).collect();
    sum.add(&shape);
    sum.value()
}

/// Whether a folder can hold block files.
///
/// # Errors
/// [`DiskError::Write`].
pub fn prepare(folder: &Path) -> Result<(), DiskError> {
    std::fs::create_dir_all(folder).map_err(|source| DiskError::Write { path: folder.to_path_buf(), source })
}
