//! Numbers that JSON writes as `null` because they are not finite come back as NaN.

use serde::{Deserialize, Deserializer};

/// A number or `null`.
pub(crate) fn number<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::<f64>::deserialize(deserializer)?.unwrap_or(f64::NAN))
}

/// Three numbers, each of them may be `null`.
pub(crate) fn three<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; 3], D::Error> {
    Ok(<[Option<f64>; 3]>::deserialize(deserializer)?.map(|value| value.unwrap_or(f64::NAN)))
}
