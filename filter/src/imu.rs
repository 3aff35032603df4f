//! Inertial measurements: increments of angle and velocity.

use nalgebra::Vector3;

/// One sample: what the IMU summed up over the interval that ends at its time, body axes (forward, right, down).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuSample {
    /// Survey time of the end of the interval \[s\].
    pub time_s: f64,
    /// Increment of angle \[rad\].
    pub angle_rad: Vector3<f64>,
    /// Increment of velocity: the integral of specific force \[m/s\].
    pub velocity_mps: Vector3<f64>,
}

/// Why inertial measurements cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ImuError {
    /// Fewer than two samples.
    #[error("an IMU file needs at least two samples, this one has {found}")]
    TooShort {
        /// Samples found.
        found: usize,
    },
    /// Times do not increase.
    #[error(
        "IMU sample {sample}: time {time_s} s does not follow {previous_s} s; sort the file or remove the duplicate"
    )]
    TimeNotIncreasing {
        /// 0-based sample.
        sample: usize,
        /// Its time \[s\].
        time_s: f64,
        /// The time before \[s\].
        previous_s: f64,
    },
    /// A number is not finite.
    #[error("IMU sample {sample} holds a value that is not a number; remove the sample or export again")]
    NotFinite {
        /// 0-based sample.
        sample: usize,
    },
}

/// Samples in order of time, strictly increasing, all finite.
#[derive(Debug, Clone, PartialEq)]
pub struct Imu {
    samples: Vec<ImuSample>,
    interval_s: f64,
}

impl Imu {
    /// Checks samples and takes them.
    ///
    /// # Errors
    /// [`ImuError`] names the first sample that is wrong.
    pub fn new(samples: Vec<ImuSample>) -> Result<Self, ImuError> {
        if samples.len() < 2 {
            return Err(ImuError::TooShort { found: samples.len() });
        }
        for (sample, s) in samples.iter().enumerate() {
            let finite = s.time_s.is_finite() && s.angle_rad.iter().chain(&s.velocity_mps).all(|v| v.is_finite());
            if !finite {
                return Err(ImuError::NotFinite { sample });
            }
            if sample > 0 && s.time_s <= samples[sample - 1].time_s {
                let previous_s = samples[sample - 1].time_s;
                return Err(ImuError::TimeNotIncreasing { sample, time_s: s.time_s, previous_s });
            }
        }
        let mut intervals: Vec<f64> = samples.windows(2).map(|w| w[1].time_s - w[0].time_s).collect();
        let middle = intervals.len() / 2;
        let interval_s = *intervals.select_nth_unstable_by(middle, f64::total_cmp).1;
        Ok(Self { samples, interval_s })
    }

    /// Samples from rates: rate gyros \[rad/s\] and specific force \[m/s²\] in place of increments, each taken as the mean
    /// of the interval that ends at its time. The first sample, whose interval is unknown, takes the usual one.
    ///
    /// # Errors
    /// As [`Imu::new`].
    pub fn from_rates(mut samples: Vec<ImuSample>) -> Result<Self, ImuError> {
        let usual_s = Self::new(samples.clone())?.interval_s;
        let mut previous_s = samples[0].time_s - usual_s;
        for s in &mut samples {
            // over a gap the rate is not known: the sample stands for the usual interval only
            let interval_s = (s.time_s - previous_s).min(1.5 * usual_s);
            previous_s = s.time_s;
            s.angle_rad *= interval_s;
            s.velocity_mps *= interval_s;
        }
        Ok(Self { samples, interval_s: usual_s })
    }

    /// The samples.
    #[must_use]
    pub fn samples(&self) -> &[ImuSample] {
        &self.samples
    }

    /// The usual interval between samples: the median \[s\].
    #[must_use]
    pub fn interval_s(&self) -> f64 {
        self.interval_s
    }

    /// First and last time \[s\].
    #[must_use]
    pub fn span_s(&self) -> (f64, f64) {
        (self.samples[0].time_s, self.samples[self.samples.len() - 1].time_s)
    }

    /// Gaps: pairs of times \[s\] between which more than half a sample is missing.
    pub fn gaps(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        let limit_s = 1.5 * self.interval_s;
        self.samples.windows(2).map(|w| (w[0].time_s, w[1].time_s)).filter(move |(a, b)| b - a > limit_s)
    }
}
