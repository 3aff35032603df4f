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

/// Numbers in rows and tables, each of which may be `null`.
pub(crate) fn numbers<'de, D: Deserializer<'de>, T: Nullable>(deserializer: D) -> Result<T, D::Error> {
    Ok(T::of(T::Stored::deserialize(deserializer)?))
}

/// What [`numbers`] reads.
pub(crate) trait Nullable: Sized {
    /// As it stands in the file.
    type Stored: for<'de> Deserialize<'de>;
    /// With NaN for what is not there.
    fn of(stored: Self::Stored) -> Self;
}

impl Nullable for f64 {
    type Stored = Option<Self>;
    fn of(stored: Self::Stored) -> Self {
        stored.unwrap_or(Self::NAN)
    }
}

impl Nullable for bool {
    type Stored = Self;
    fn of(stored: Self) -> Self {
        stored
    }
}

impl<T: Nullable> Nullable for Vec<T> {
    type Stored = Vec<T::Stored>;
    fn of(stored: Self::Stored) -> Self {
        stored.into_iter().map(T::of).collect()
    }
}

impl<T: Nullable> Nullable for Option<T> {
    type Stored = Option<T::Stored>;
    fn of(stored: Self::Stored) -> Self {
        stored.map(T::of)
    }
}

macro_rules! rows {
    ($($n:literal),*) => {$(
        impl<T: Nullable> Nullable for [T; $n] {
            type Stored = [T::Stored; $n];
            fn of(stored: Self::Stored) -> Self {
                stored.map(T::of)
            }
        }
    )*};
}

rows!(2, 3, 6);

impl<A: Nullable, B: Nullable> Nullable for (A, B) {
    type Stored = (A::Stored, B::Stored);
    fn of((a, b): Self::Stored) -> Self {
        (A::of(a), B::of(b))
    }
}

impl<A: Nullable, B: Nullable, C: Nullable> Nullable for (A, B, C) {
    type Stored = (A::Stored, B::Stored, C::Stored);
    fn of((a, b, c): Self::Stored) -> Self {
        (A::of(a), B::of(b), C::of(c))
    }
}
