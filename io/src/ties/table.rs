//! The columns of a table of ties, named once: rows, table, Parquet schema and CSV header all follow from this list.

use super::columns::{Column, ColumnMut, Store, TextColumn};

macro_rules! tie_columns {
    ($($(#[doc = $doc:literal])+ $name:ident: $value:ty, $unknown:expr, $store:ty;)+) => {
        /// One end of a tie.
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct TieRow<'a> {
            $($(#[doc = $doc])+ pub $name: $value,)+
        }

        impl Default for TieRow<'_> {
            /// Everything unknown: NaN, empty, zero.
            fn default() -> Self {
                Self { $($name: $unknown,)+ }
            }
        }

        /// Ties in columns; all of one length.
        #[derive(Debug, Clone, Default)]
        pub struct TieTable {
            $($(#[doc = $doc])+ pub $name: $store,)+
        }

        impl TieTable {
            /// Adds a row.
            pub fn push(&mut self, row: &TieRow<'_>) {
                $(self.$name.push(row.$name);)+
            }

            /// The columns with their names, in the order of the files.
            pub(super) fn columns(&self) -> Vec<(&'static str, Column<'_>)> {
                vec![$((stringify!($name), self.$name.view()),)+]
            }

            /// The columns to be filled.
            pub(super) fn columns_mut(&mut self) -> Vec<(&'static str, ColumnMut<'_>)> {
                vec![$((stringify!($name), self.$name.view_mut()),)+]
            }
        }
    };
}

tie_columns! {
    /// Number of the tie, unique in a survey; its ends share it.
    tie_id: i64, 0, Vec<i64>;
    /// `surface_line`, `line`, `xyz_point`, `increment`, `submap` or `control`.
    kind: &'a str, "", TextColumn;
    /// Class of ties that shares a variance component.
    class: &'a str, "", TextColumn;
    /// Number of the end within its tie, from 0.
    end: i32, 0, Vec<i32>;
    /// Name of the strip; empty for the known end of a control tie.
    strip: &'a str, "", TextColumn;
    /// Visit of the strip to this place, from 0.
    pass: i32, 0, Vec<i32>;
    /// Scanner on the platform, 0-based.
    scanner: i32, 0, Vec<i32>;
    /// Time \[s\], as in the strip.
    gps_time_s: f64, f64::NAN, Vec<f64>;
    /// From the IMU to the feature, body frame: forward \[m\].
    body_x_m: f64, f64::NAN, Vec<f64>;
    /// From the IMU to the feature, body frame: right \[m\].
    body_y_m: f64, f64::NAN, Vec<f64>;
    /// From the IMU to the feature, body frame: down \[m\].
    body_z_m: f64, f64::NAN, Vec<f64>;
    /// Unit vector of the beam, scanner frame.
    beam_x: f64, f64::NAN, Vec<f64>;
    /// Unit vector of the beam, scanner frame.
    beam_y: f64, f64::NAN, Vec<f64>;
    /// Unit vector of the beam, scanner frame.
    beam_z: f64, f64::NAN, Vec<f64>;
    /// From the scanner to the feature \[m\].
    range_m: f64, f64::NAN, Vec<f64>;
    /// Angle between beam and normal \[deg\].
    incidence_deg: f64, f64::NAN, Vec<f64>;
    /// Mean intensity.
    intensity: f64, f64::NAN, Vec<f64>;
    /// Easting of the feature as this end saw it \[m\].
    map_e_m: f64, f64::NAN, Vec<f64>;
    /// Northing of the feature as this end saw it \[m\].
    map_n_m: f64, f64::NAN, Vec<f64>;
    /// Height of the feature as this end saw it \[m\].
    map_h_m: f64, f64::NAN, Vec<f64>;
    /// Unit normal of a surface line: east.
    normal_e: f64, f64::NAN, Vec<f64>;
    /// Unit normal of a surface line: north.
    normal_n: f64, f64::NAN, Vec<f64>;
    /// Unit normal of a surface line: up.
    normal_u: f64, f64::NAN, Vec<f64>;
    /// One sigma along the normal \[m\]; unknown for point ties.
    sigma_m: f64, f64::NAN, Vec<f64>;
    /// Covariance of a point tie \[m²\]: east, east. Unknown for surface lines.
    cov_ee_m2: f64, f64::NAN, Vec<f64>;
    /// Covariance of a point tie \[m²\]: east, north.
    cov_en_m2: f64, f64::NAN, Vec<f64>;
    /// Covariance of a point tie \[m²\]: east, up.
    cov_eu_m2: f64, f64::NAN, Vec<f64>;
    /// Covariance of a point tie \[m²\]: north, north.
    cov_nn_m2: f64, f64::NAN, Vec<f64>;
    /// Covariance of a point tie \[m²\]: north, up.
    cov_nu_m2: f64, f64::NAN, Vec<f64>;
    /// Covariance of a point tie \[m²\]: up, up.
    cov_uu_m2: f64, f64::NAN, Vec<f64>;
    /// Residual of the tie before the solution \[m\].
    residual_before_m: f64, f64::NAN, Vec<f64>;
    /// Residual of the tie after the solution \[m\].
    residual_after_m: f64, f64::NAN, Vec<f64>;
    /// Whether the solution used the tie.
    used: bool, false, Vec<bool>;
    /// Whether the tie was held out of the solution to check it.
    held_out: bool, false, Vec<bool>;
    /// Why the tie was not used; empty when it was.
    why_not: &'a str, "", TextColumn;
}

impl TieTable {
    /// Number of rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.tie_id.len()
    }
    /// Whether there is no row.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.tie_id.is_empty()
    }
}

impl PartialEq for TieTable {
    /// Equal when every value is, unknown ones included.
    fn eq(&self, other: &Self) -> bool {
        self.columns().into_iter().zip(other.columns()).all(|((_, a), (_, b))| match (a, b) {
            (Column::Long(a), Column::Long(b)) => a == b,
            (Column::Int(a), Column::Int(b)) => a == b,
            (Column::Flag(a), Column::Flag(b)) => a == b,
            (Column::Text(a), Column::Text(b)) => a == b,
            (Column::Double(a), Column::Double(b)) => {
                let same = |(a, b): (&f64, &f64)| a == b || a.is_nan() && b.is_nan();
                a.len() == b.len() && a.iter().zip(b).all(same)
            }
            _ => false,
        })
    }
}
