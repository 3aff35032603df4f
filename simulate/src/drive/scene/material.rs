//! What surfaces are made of: how much light they send back, how rough they are, and their class.

/// A material. Its number is its place here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Material {
    /// Road.
    Asphalt,
    /// Road that was mended.
    Patch,
    /// Paint on the road.
    Marking,
    /// Cast iron.
    Manhole,
    /// Pavement.
    Pavement,
    /// Curb.
    Curb,
    /// Grass and gravel.
    Verge,
    /// Plaster.
    Facade,
    /// Reveals of windows and doors.
    Reveal,
    /// Glass.
    Window,
    /// Galvanised steel.
    Pole,
    /// Bark.
    Trunk,
    /// Leaves.
    Foliage,
    /// Sheet metal of a car that stands.
    ParkedCar,
    /// Sheet metal of a car that drives.
    MovingCar,
}

impl Material {
    /// Share of the light that comes back.
    pub(in crate::drive) fn reflectance(self) -> f64 {
        match self {
            Self::Asphalt => 0.14,
            Self::Patch => 0.08,
            Self::Marking => 0.55,
            Self::Manhole => 0.30,
            Self::Pavement | Self::Pole => 0.28,
            Self::Curb => 0.33,
            Self::Verge => 0.35,
            Self::Facade => 0.42,
            Self::Reveal => 0.38,
            Self::Window => 0.05,
            Self::Trunk => 0.20,
            Self::Foliage => 0.40,
            Self::ParkedCar | Self::MovingCar => 0.25,
        }
    }

    /// Roughness, in that of asphalt.
    pub(super) fn roughness(self) -> f64 {
        match self {
            Self::Verge => 10.0,
            Self::Trunk => 3.0,
            Self::Asphalt | Self::Patch | Self::Pavement | Self::Curb => 1.0,
            _ => 0.3,
        }
    }

    /// Class in `truth/strips`: that of ASPRS, from 64 on our own.
    #[must_use]
    pub fn class(self) -> u8 {
        match self {
            Self::Asphalt | Self::Patch | Self::Verge => 2,
            Self::Foliage | Self::Trunk => 5,
            Self::Facade => 6,
            Self::Pole => 64,
            Self::Marking => 65,
            Self::Manhole => 66,
            Self::ParkedCar => 67,
            Self::MovingCar => 68,
            Self::Pavement | Self::Curb => 70,
            Self::Reveal | Self::Window => 71,
        }
    }
}
