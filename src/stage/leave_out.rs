//! Lines that are left out of those of a survey.

use tieline_matching::SurfaceLine;

use super::ties::Ties;

impl Ties {
    /// Leaves out lines; gives how many.
    pub fn leave_out(&mut self, is_left_out: impl Fn(&SurfaceLine) -> bool) -> usize {
        let keep: Vec<bool> = self.lines.iter().map(|line| !is_left_out(line)).collect();
        self.keep(&keep);
        keep.iter().filter(|kept| !**kept).count()
    }

    /// Keeps some lines; those selected keep what is said of them.
    pub(super) fn keep(&mut self, keep: &[bool]) {
        let mut new_row = vec![0; keep.len()];
        let mut next = 0;
        for (row, kept) in new_row.iter_mut().zip(keep) {
            *row = next;
            next += usize::from(*kept);
        }
        let mut kept_selected = self.selected.iter().map(|row| keep[*row]);
        self.held_out.retain(|_| kept_selected.next().unwrap_or(true));
        self.selected.retain(|row| keep[*row]);
        self.selected.iter_mut().for_each(|row| *row = new_row[*row]);
        let mut kept = keep.iter();
        self.lines.retain(|_| *kept.next().unwrap_or(&true));
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use tieline_matching::{End, Patch, Sighting};

    use super::*;

    #[test]
    fn what_is_said_of_selected_lines_stays_with_them_when_others_go() {
        let line = |time_s: f64| {
            let patch = Patch {
                sighting: Sighting { strip: 0, pass: 0, scanner: 0 },
                time_s,
                centroid_m: Vector3::zeros(),
                normal: Vector3::z(),
                long_axis: Vector3::x(),
                spread_m: [0.2, 0.1],
                roughness_m: 0.005,
                points: 40,
                intensity: 0.0,
            };
            SurfaceLine { ends: vec![End { patch, rejection: None }] }
        };
        let mut ties = Ties {
            lines: (0..6).map(|k| line(f64::from(k))).collect(),
            selected: vec![0, 2, 3, 5],
            held_out: vec![false, true, false, true],
            ..Ties::default()
        };
        let time_s = |line: &SurfaceLine| line.ends[0].patch.time_s;
        let left_out = ties.leave_out(|line| (0.5..2.5).contains(&time_s(line)));
        assert_eq!((left_out, ties.lines.len()), (2, 4));
        let selected: Vec<f64> = ties.selected.iter().map(|row| time_s(&ties.lines[*row])).collect();
        assert_eq!((selected, ties.held_out), (vec![0.0, 3.0, 5.0], vec![false, false, true]));
    }
}
