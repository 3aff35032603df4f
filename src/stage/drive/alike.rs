//! Whether drives can share a calibration: what is common to them must be the same thing.

use anyhow::{Result, bail};

use super::known::Known;
use crate::project::{Project, ScannerSection};

/// Lever arms \[m\] and angles \[deg\] of one platform, written twice, differ by no more than this.
const SAME: f64 = 1e-9;

/// Refuses drives whose platforms, known calibrations or wishes differ: names, projects, what is known of their scanners.
///
/// # Errors
/// Which two drives differ, in what, and what to do.
pub fn check_alike(drives: &[(&str, &Project, &[Known])]) -> Result<()> {
    let Some(((first, project, known), others)) = drives.split_first() else { return Ok(()) };
    for (name, other, other_known) in others {
        let ids = |p: &Project| {
            let mut ids: Vec<u16> = p.platform.scanner.iter().map(|s| s.id).collect();
            ids.sort_unstable();
            ids
        };
        if ids(project) != ids(other) {
            bail!(
                "drive {first} has scanners {:?} and drive {name} has {:?} (platform.scanner.id): only drives with the same scanners share a \
                 calibration",
                ids(project),
                ids(other)
            );
        }
        for scanner in &project.platform.scanner {
            let Some(same) = other.platform.scanner.iter().find(|s| s.id == scanner.id) else { continue };
            let values = |s: &ScannerSection| {
                [("lever_arm_m", s.lever_arm_m), ("mounting_deg", s.mounting_deg), ("boresight_deg", s.boresight_deg)]
            };
            for ((key, a), (_, b)) in values(scanner).into_iter().zip(values(same)) {
                if a.iter().zip(b).any(|(x, y)| (x - y).abs() > SAME) {
                    bail!(
                        "platform.scanner {}: {key} is {a:?} in drive {first} and {b:?} in drive {name}: corrections count from these values, so \
                         that only drives whose strips were made with the same platform share a calibration; where it was measured anew, calibrate \
                         each alone",
                        scanner.id
                    );
                }
            }
        }
        let wishes = |p: &Project| {
            let mut wishes = p.calibrate.clone();
            wishes.known = None;
            wishes
        };
        if wishes(project) != wishes(other) {
            bail!("[calibrate] of drive {first} and of drive {name} differ: give all drives the same terms and sigmas");
        }
        if *known != *other_known {
            bail!(
                "calibrate.known of drive {first} and of drive {name} are different calibrations: give all drives the same one, or none"
            );
        }
    }
    Ok(())
}

/// Refuses drives whose strips number their scanners differently: names, and the numbers in their files.
///
/// # Errors
/// Which two drives differ.
pub fn check_numbers(drives: &[(&str, Vec<u16>)]) -> Result<()> {
    let Some(((first, numbers), others)) = drives.split_first() else { return Ok(()) };
    if let Some((name, other)) = others.iter().find(|(_, other)| other != numbers) {
        bail!(
            "the strips of drive {first} hold scanners with the numbers {numbers:?}, those of drive {name} {other:?}: give drives in which all \
             scanners measured"
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::project::parse_str;

    fn project(scanners: &str, more: &str) -> Project {
        parse_str(&format!(
            "[[strips]]\npath = \"*.laz\"\n[imu]\npath = \"imu.txt\"\ngrade = \"ap60\"\n[platform]\n{scanners}{more}"
        ))
        .expect("a project")
    }

    const TWO: &str = "[[platform.scanner]]\nid = 0\nlever_arm_m = [1.0, 0.2, -0.3]\nmounting_deg = [0.0, 20.0, 135.0]\n\
                       [[platform.scanner]]\nid = 1\nlever_arm_m = [1.0, -0.2, -0.3]\nmounting_deg = [0.0, 20.0, -135.0]\n";

    #[test]
    fn drives_of_one_platform_are_taken_in_any_order_of_scanners() {
        let (a, b) = (project(TWO, ""), project(TWO, ""));
        let mut c = b.clone();
        c.platform.scanner.reverse();
        check_alike(&[("a", &a, &[]), ("b", &b, &[]), ("c", &c, &[])]).expect("alike");
        check_numbers(&[("a", vec![0, 1]), ("b", vec![0, 1])]).expect("alike");
    }

    #[test]
    fn what_differs_is_named_with_both_drives() {
        let a = project(TWO, "");
        let refuse = |b: &Project, known: &[Known], words: &[&str]| {
            let error = check_alike(&[("monday", &a, &[]), ("friday", b, known)]).expect_err("refused").to_string();
            for word in words.iter().chain(&["monday", "friday"]) {
                assert!(error.contains(word), "{word} is not in {error}");
            }
        };
        refuse(&project(&TWO.replace("id = 1", "id = 2"), ""), &[], &["[0, 1]", "[0, 2]"]);
        let turned = TWO.replace("20.0, -135.0", "20.5, -135.0");
        refuse(&project(&turned, ""), &[], &["platform.scanner 1", "mounting_deg", "20.5"]);
        refuse(
            &project(&TWO.replace("[1.0, 0.2", "[1.1, 0.2"), ""),
            &[],
            &["platform.scanner 0", "lever_arm_m", "1.1"],
        );
        refuse(&project(TWO, "[calibrate]\nlatency = false\n"), &[], &["[calibrate]", "same terms"]);
        refuse(&project(TWO, ""), &[Known { latency_s: 1e-4, ..Known::default() }], &["calibrate.known"]);
        let error = check_numbers(&[("monday", vec![0, 1]), ("friday", vec![1])]).expect_err("refused").to_string();
        assert!(error.contains("friday") && error.contains("[1]"), "{error}");
    }
}
