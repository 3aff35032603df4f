//! Same bytes for any number of threads; nothing but coordinates changed; the way back.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};

use super::Row;
use super::real::{program, root, run};

const COMPARE: &str = r#"
import laspy, numpy as np, sys
a, b, tolerance = laspy.read(sys.argv[1]), laspy.read(sys.argv[2]), float(sys.argv[3])
assert len(a.points) == len(b.points), "number of points"
assert a.header.point_format.id == b.header.point_format.id and a.header.version == b.header.version
names = [d.name for d in a.point_format.dimensions if d.name not in ("X", "Y", "Z")]
assert names == [d.name for d in b.point_format.dimensions if d.name not in ("X", "Y", "Z")]
different = [n for n in names if np.asarray(a[n]).tobytes() != np.asarray(b[n]).tobytes()]
assert not different, different
if tolerance > 0:
    worst = max(np.abs(np.asarray(a[k]) - np.asarray(b[k])).max() for k in ("x", "y", "z"))
    assert worst <= tolerance * 1.0001, worst
print(len(names))
"#;

fn compare(a: &Path, b: &Path, tolerance_m: f64) -> Result<f64> {
    let output = Command::new("python3").args(["-c", COMPARE]).arg(a).arg(b).arg(tolerance_m.to_string()).output()?;
    ensure!(
        output.status.success(),
        "{} and {}: {}",
        a.display(),
        b.display(),
        String::from_utf8_lossy(&output.stderr)
    );
    Ok(String::from_utf8_lossy(&output.stdout).trim().parse()?)
}

fn files_of(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)?.filter_map(|e| e.ok().map(|e| e.path())).collect();
    files.sort();
    Ok(files)
}

/// Line 6.
pub(crate) fn rows() -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for name in ["als-zurich-8strips", "als-bcts-3strips", "als-ign-dual-scanner"] {
        let project = root().join(format!("samples/real/{name}.toml"));
        let (one, two) = (tempfile::tempdir()?, tempfile::tempdir()?);
        run(&project, one.path(), 1)?;
        run(&project, two.path(), 2)?;
        let mut different = 0_u32;
        for file in ["ties.parquet", "calibration.toml", "correction.csv"] {
            different += u32::from(std::fs::read(one.path().join(file))? != std::fs::read(two.path().join(file))?);
        }
        let corrected = files_of(&one.path().join("corrected"))?;
        for file in &corrected {
            let other = two.path().join("corrected").join(file.file_name().context("a name")?);
            different += u32::from(std::fs::read(file)? != std::fs::read(other)?);
        }
        rows.push(Row::at_most(format!("{name}: files that differ with threads"), f64::from(different), 0.0, ""));
        let source = root().join(format!("../shared/data/{name}"));
        let mut fields = f64::INFINITY;
        for file in &corrected {
            fields = fields.min(compare(&source.join(file.file_name().context("a name")?), file, 0.0)?);
        }
        rows.push(Row::between(format!("{name}: fields equal in every point (laspy)"), fields, 10.0, 1e3, ""));
        let status = Command::new(program()?)
            .args(["correct", "--quiet", "--inverse", "--out"])
            .arg(one.path())
            .arg(&project)
            .args(&corrected)
            .status()?;
        ensure!(status.success(), "correct --inverse");
        for file in files_of(&one.path().join("restored"))? {
            // one scale unit of the input: 1 cm in all three data sets
            compare(&source.join(file.file_name().context("a name")?), &file, 0.01)?;
        }
        rows.push(Row::at_most(format!("{name}: inverse beyond one scale unit"), 0.0, 0.0, "points"));
    }
    Ok(rows)
}
