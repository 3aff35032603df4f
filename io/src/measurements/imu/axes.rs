//! Where the axes of an IMU point.

use std::fmt;
use std::str::FromStr;

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// Where the axes x, y, z of a sensor point: a letter each, `F`orward or `B`ack, `R`ight or `L`eft, `U`p or `D`own.
///
/// ```
/// use tieline_io::measurements::Axes;
/// let axes: Axes = "RFU".parse()?; // x right, y forward, z up
/// let body = axes.body_from_sensor() * nalgebra::Vector3::new(1.0, 2.0, 3.0);
/// assert_eq!(body, nalgebra::Vector3::new(2.0, 1.0, -3.0));
/// # Ok::<(), tieline_io::measurements::AxesError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Axes([char; 3]);

/// Why three letters are no axes.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum AxesError {
    /// Not three letters, or others than these.
    #[error(
        "axes \"{found}\" are not understood; say a letter of F or B, R or L, U or D for each of x, y, z, such as \"FRD\""
    )]
    Letters {
        /// What was given.
        found: String,
    },
    /// Two axes along the same line.
    #[error("axes \"{found}\" name a direction twice; x, y and z need one each of F or B, R or L, U or D")]
    Twice {
        /// What was given.
        found: String,
    },
    /// A mirrored sensor.
    #[error("axes \"{found}\" are left-handed; turn one letter round (\"{remedy}\" would be right-handed)")]
    LeftHanded {
        /// What was given.
        found: String,
        /// The same with its last axis turned round.
        remedy: String,
    },
}

impl Default for Axes {
    fn default() -> Self {
        Self(['F', 'R', 'D'])
    }
}

impl Axes {
    /// Turns a vector along the axes of the sensor into forward, right, down.
    #[must_use]
    pub fn body_from_sensor(&self) -> Matrix3<f64> {
        Matrix3::from_columns(&self.0.map(direction))
    }
}

/// The direction of a letter, forward, right, down; zero for any other letter.
fn direction(letter: char) -> Vector3<f64> {
    match letter {
        'F' => Vector3::x(),
        'B' => -Vector3::x(),
        'R' => Vector3::y(),
        'L' => -Vector3::y(),
        'D' => Vector3::z(),
        'U' => -Vector3::z(),
        _ => Vector3::zeros(),
    }
}

/// The letter of the other direction.
fn turned(letter: char) -> char {
    match letter {
        'F' => 'B',
        'B' => 'F',
        'R' => 'L',
        'L' => 'R',
        'D' => 'U',
        _ => 'D',
    }
}

impl FromStr for Axes {
    type Err = AxesError;

    fn from_str(text: &str) -> Result<Self, AxesError> {
        let found = || text.chars().take(40).collect::<String>();
        let mut letters = text.trim().chars().map(|c| c.to_ascii_uppercase());
        let axes = match (letters.next(), letters.next(), letters.next(), letters.next()) {
            (Some(x), Some(y), Some(z), None) => Self([x, y, z]),
            _ => return Err(AxesError::Letters { found: found() }),
        };
        if axes.0.iter().any(|&letter| direction(letter) == Vector3::zeros()) {
            return Err(AxesError::Letters { found: found() });
        }
        match axes.body_from_sensor().determinant() {
            right if right > 0.5 => Ok(axes),
            left if left < -0.5 => {
                let remedy = Self([axes.0[0], axes.0[1], turned(axes.0[2])]).to_string();
                Err(AxesError::LeftHanded { found: found(), remedy })
            }
            _ => Err(AxesError::Twice { found: found() }),
        }
    }
}

impl fmt::Display for Axes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|letter| write!(f, "{letter}"))
    }
}

impl TryFrom<String> for Axes {
    type Error = AxesError;

    fn try_from(text: String) -> Result<Self, AxesError> {
        text.parse()
    }
}

impl From<Axes> for String {
    fn from(axes: Axes) -> Self {
        axes.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_right_handed_sensor_turns_forward_right_down() {
        let (mut right, mut left, mut twice) = (0, 0, 0);
        for x in "FBRLUD".chars() {
            for y in "FBRLUD".chars() {
                for z in "FBRLUD".chars() {
                    let text: String = [x, y, z].iter().collect();
                    match text.parse::<Axes>() {
                        Ok(axes) => {
                            right += 1;
                            let rotation = axes.body_from_sensor();
                            assert_eq!(rotation * rotation.transpose(), Matrix3::identity());
                            assert!(rotation.determinant() > 0.0);
                            assert_eq!(axes.to_string(), text);
                        }
                        Err(AxesError::LeftHanded { remedy, .. }) => {
                            left += 1;
                            assert!(remedy.parse::<Axes>().is_ok(), "{remedy}");
                        }
                        Err(AxesError::Twice { .. }) => twice += 1,
                        Err(other) => panic!("{other}"),
                    }
                }
            }
        }
        assert_eq!((right, left, twice), (24, 24, 168));
    }

    #[test]
    fn letters_that_mean_nothing_are_refused() {
        for text in ["", "FR", "FRDD", "NED", "xyz", "F D", "ÄÖÜ"] {
            assert!(matches!(text.parse::<Axes>(), Err(AxesError::Letters { .. })), "{text}");
        }
        assert_eq!("frd".parse::<Axes>(), Ok(Axes::default()));
        assert_eq!(" bld ".parse::<Axes>().map(|a| a.to_string()), Ok("BLD".to_string()));
    }
}
