//! Output appears whole or not at all: a file is written beside its final name and renamed when complete.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// A file in the making beside its final name; removed when dropped before [`WholeFile::finish`].
#[derive(Debug)]
pub struct WholeFile {
    final_path: PathBuf,
    partial_path: PathBuf,
    writer: Option<BufWriter<File>>,
}

impl WholeFile {
    /// Starts the file `path` under the name `path` + `.partial`.
    ///
    /// # Errors
    /// When the folder does not exist or cannot be written to.
    pub fn create(path: &Path) -> io::Result<Self> {
        let mut name = path.file_name().unwrap_or_default().to_os_string();
        name.push(".partial");
        let partial_path = path.with_file_name(name);
        let writer = BufWriter::with_capacity(
            1 << 20,
            File::options().read(true).write(true).create(true).truncate(true).open(&partial_path)?,
        );
        Ok(Self { final_path: path.to_path_buf(), partial_path, writer: Some(writer) })
    }

    /// The writer; seekable through [`BufWriter`].
    ///
    /// # Panics
    /// Never: the writer lives until [`WholeFile::finish`], which consumes `self`.
    #[allow(clippy::expect_used)]
    pub fn writer(&mut self) -> &mut BufWriter<File> {
        self.writer.as_mut().expect("present until finish")
    }

    /// Flushes and renames to the final name.
    ///
    /// # Errors
    /// When the disk is full or the rename fails; the partial file is then removed.
    pub fn finish(mut self) -> io::Result<()> {
        if let Some(mut writer) = self.writer.take() {
            writer.flush()?;
            writer.into_inner().map_err(io::IntoInnerError::into_error)?.sync_data()?;
        }
        fs::rename(&self.partial_path, &self.final_path)
    }
}

impl Drop for WholeFile {
    fn drop(&mut self) {
        self.writer = None;
        if self.partial_path.exists() {
            let _ = fs::remove_file(&self.partial_path);
        }
    }
}

/// Writes `bytes` to `path`, whole or not at all.
///
/// # Errors
/// As [`WholeFile::create`] and [`WholeFile::finish`].
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = WholeFile::create(path)?;
    file.writer().write_all(bytes)?;
    file.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_abandoned_file_leaves_nothing_behind() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("ties.csv");
        let mut file = WholeFile::create(&path).expect("created");
        file.writer().write_all(b"half").expect("written");
        drop(file);
        assert_eq!(fs::read_dir(folder.path()).expect("listed").count(), 0);
    }

    #[test]
    fn a_finished_file_has_its_final_name_only() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("ties.csv");
        write_whole(&path, b"whole").expect("written");
        assert_eq!(fs::read(&path).expect("read"), b"whole");
        assert_eq!(fs::read_dir(folder.path()).expect("listed").count(), 1);
    }
}
