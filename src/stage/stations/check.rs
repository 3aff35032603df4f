//! Whether the stations agree: each solved by itself against all together; and what ground alone would tell.

use nalgebra::DMatrix;
use tieline_filter::innovation::chi_squared_limit;
use tieline_graph::{AdjustOptions, Adjustment, Line, Model, Parameter, ParameterBlock, adjust};

use super::pairs::{CommonPlane, Slope};
use super::solve::Round;

/// Probability that stations are said to disagree though they do not.
const FALSE_ALARM: f64 = 0.01;
/// A station's own value counts where its planes tell more than this share of it.
const SEEN_BY_STATION: f64 = 0.9;

/// What one station says by itself.
#[derive(Debug, Clone, PartialEq)]
pub struct StationValue {
    /// Index of the station.
    pub station: usize,
    /// Values of the unknowns.
    pub value: Vec<f64>,
    /// Their sigmas.
    pub sigma: Vec<f64>,
    /// Which of them it sees by itself.
    pub seen: Vec<bool>,
}

/// The mounting's part of the unknowns.
pub(super) struct Mounting {
    pub(super) parameters: Vec<Parameter>,
    pub(super) values: Vec<f64>,
    pub(super) covariance: DMatrix<f64>,
}

impl Mounting {
    pub(super) fn of(model: &Model, covariance: &DMatrix<f64>) -> Self {
        let rows = mounting_rows(model);
        Self {
            parameters: rows.iter().map(|i| model.parameters()[*i].clone()).collect(),
            values: rows.iter().map(|i| model.state()[*i]).collect(),
            covariance: DMatrix::from_fn(rows.len(), rows.len(), |i, j| covariance[(rows[i], rows[j])]),
        }
    }
}

pub(super) fn mounting_rows(model: &Model) -> Vec<usize> {
    let of_scanner = |i: &usize| matches!(model.parameters()[*i].block, ParameterBlock::Calibration(_));
    (0..model.count()).filter(of_scanner).collect()
}

/// The same adjustment with some of the lines only; `None` where they are too few.
fn adjusted_with(round: &Round, model: &Model, keep: impl Fn(&CommonPlane) -> bool) -> Option<(Model, Adjustment)> {
    let lines: Vec<Line> =
        round.planes.iter().zip(&round.lines).filter(|(p, _)| keep(p)).map(|(_, (line, _))| line.clone()).collect();
    let mut own = model.clone();
    let scale = &round.adjustment.class_scale;
    adjust(&mut own, &lines, scale, &AdjustOptions::default()).ok().map(|adjustment| (own, adjustment))
}

/// What each station says by itself.
pub(super) fn station_values(round: &Round, model: &Model, stations: usize) -> Vec<StationValue> {
    (0..stations)
        .filter_map(|station| {
            let (own, adjustment) = adjusted_with(round, model, |p| p.station == station)?;
            let rows = mounting_rows(&own);
            let own = Mounting::of(&own, &adjustment.covariance);
            Some(StationValue {
                station,
                sigma: (0..rows.len()).map(|i| own.covariance[(i, i)].max(0.0).sqrt()).collect(),
                seen: rows.iter().map(|i| adjustment.observability.share[*i] > SEEN_BY_STATION).collect(),
                value: own.values,
            })
        })
        .collect()
}

/// How far stations lie from the common solution, in sigmas of that difference (`C_s - C`), and the factor on the
/// sigmas that follows when it is more than chance.
#[allow(clippy::cast_precision_loss)]
pub(super) fn agreement(stations: &[StationValue], common: &Mounting) -> (f64, f64) {
    let (mut sum, mut n) = (0.0, 0_usize);
    if stations.len() < 2 {
        return (f64::NAN, 1.0);
    }
    for station in stations {
        for i in (0..common.values.len()).filter(|i| station.seen[*i]) {
            let variance = station.sigma[i].powi(2) - common.covariance[(i, i)];
            if variance > 0.1 * station.sigma[i].powi(2) {
                sum += (station.value[i] - common.values[i]).powi(2) / variance;
                n += 1;
            }
        }
    }
    if n == 0 {
        return (f64::NAN, 1.0);
    }
    let misfit = (sum / n as f64).sqrt();
    // deviations from a common value leave one station less than there are
    let freedom = (n * (stations.len() - 1) / stations.len()).max(1);
    let limit = chi_squared_limit(freedom, FALSE_ALARM) / freedom as f64;
    (misfit, if misfit.powi(2) > limit { misfit } else { 1.0 })
}

/// Covariance from ground alone.
pub(super) fn without_walls(round: &Round, model: &Model) -> Option<DMatrix<f64>> {
    adjusted_with(round, model, |p| p.slope == Slope::Level)
        .map(|(own, adjustment)| Mounting::of(&own, &adjustment.covariance).covariance)
}
