//! The bytes of an input file, read at any position by any thread.
//!
//! Positional reads, not a memory map: a map counts against the memory of the process, dies with a signal when the
//! file is cut or its disk fails, and needs `unsafe`; next to the entropy decoder it gains nothing.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use super::error::LasError;

/// An open file, its path and its length.
#[derive(Debug)]
pub(super) struct Input {
    file: File,
    path: PathBuf,
    length: u64,
}

impl Input {
    pub(super) fn open(path: &Path) -> Result<Self, LasError> {
        let failed = |action| move |source| LasError::Io { path: path.into(), action, source };
        let file = File::open(path).map_err(failed("open it"))?;
        let metadata = file.metadata().map_err(failed("ask for its length"))?;
        if metadata.is_dir() {
            return Err(failed("read it")(io::Error::other("it is a folder")));
        }
        Ok(Self { file, path: path.to_path_buf(), length: metadata.len() })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Length \[bytes\] of the file when it was opened.
    pub(super) fn length(&self) -> u64 {
        self.length
    }

    /// Fills `buffer` from byte `at` of the file on.
    pub(super) fn read(&self, buffer: &mut [u8], at: u64) -> Result<(), LasError> {
        read_exact_at(&self.file, buffer, at).map_err(|source| LasError::Io {
            path: self.path.clone(),
            action: "read it",
            source,
        })
    }

    /// `length` bytes from byte `at` on; the caller has checked that the file has them.
    pub(super) fn read_vec(&self, at: u64, length: u64) -> Result<Vec<u8>, LasError> {
        let left = self.length.saturating_sub(at);
        let Some(length) = usize::try_from(length).ok().filter(|_| length <= left) else {
            let source = io::Error::from(io::ErrorKind::UnexpectedEof);
            return Err(LasError::Io { path: self.path.clone(), action: "read past its end", source });
        };
        let mut bytes = vec![0; length];
        self.read(&mut bytes, at)?;
        Ok(bytes)
    }
}

#[cfg(unix)]
fn read_exact_at(file: &File, buffer: &mut [u8], at: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, buffer, at)
}

#[cfg(windows)]
fn read_exact_at(file: &File, mut buffer: &mut [u8], mut at: u64) -> io::Result<()> {
    use std::os::windows::fs::FileExt;
    while !buffer.is_empty() {
        match file.seek_read(buffer, at) {
            Ok(0) => return Err(io::Error::from(io::ErrorKind::UnexpectedEof)),
            Ok(count) => {
                buffer = &mut buffer[count..];
                at += count as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}
