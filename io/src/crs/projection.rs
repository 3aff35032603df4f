//! A coordinate reference system and single points in it.

use nalgebra::{Matrix3, Vector3};
use proj4rs::Proj;
use proj4rs::transform::transform;
use tieline_filter::earth::{ecef_from_geodetic, geodetic_from_ecef, ned_from_ecef};

use super::error::CrsError;

/// What a coordinate reference system is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CrsKind {
    /// Latitude and longitude in degrees.
    Geographic,
    /// Easting and northing of a map projection, metres.
    Projected,
    /// East, north, up about an origin on the ellipsoid, metres.
    Local,
}

/// A coordinate reference system. Construct with [`Crs::parse`], [`Crs::local`] or [`Crs::from_geokeys`].
#[derive(Clone)]
pub struct Crs {
    pub(super) name: String,
    pub(super) kind: CrsKind,
    pub(super) epsg: Option<u32>,
    pub(super) vertical: Option<String>,
    pub(super) proj_string: String,
    pub(super) projection: Option<Proj>,
    pub(super) wgs84: Option<Proj>,
    pub(super) origin: Option<Origin>,
    pub(super) undulation_m: f64,
}

/// Origin of a local system.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Origin {
    pub(super) geodetic: Vector3<f64>,
    pub(super) ecef_m: Vector3<f64>,
    pub(super) ned_from_ecef: Matrix3<f64>,
}

/// Turns north, east, down into east, north, up; its own inverse.
pub(super) const ENU_FROM_NED: Matrix3<f64> = Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0);

impl std::fmt::Debug for Crs {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Crs")
            .field("name", &self.name)
            .field("kind", &self.kind)
            .field("epsg", &self.epsg)
            .field("vertical", &self.vertical)
            .field("proj_string", &self.proj_string)
            .field("origin", &self.origin)
            .field("undulation_m", &self.undulation_m)
            .finish_non_exhaustive()
    }
}

impl Crs {
    /// East, north, up about latitude \[rad\], longitude \[rad\] and ellipsoidal height \[m\].
    ///
    /// # Errors
    /// [`CrsError::BadOrigin`] when that is no place.
    pub fn local(origin: Vector3<f64>) -> Result<Self, CrsError> {
        Self::local_without_origin().with_origin(origin)
    }

    /// A local system whose place on the earth nobody knows: good for map trajectories only.
    pub(super) fn local_without_origin() -> Self {
        Self {
            name: "local".into(),
            kind: CrsKind::Local,
            epsg: None,
            vertical: None,
            proj_string: String::new(),
            projection: None,
            wgs84: None,
            origin: None,
            undulation_m: 0.0,
        }
    }

    /// The same local system about an origin: latitude \[rad\], longitude \[rad\], ellipsoidal height \[m\].
    /// A projected system needs none and stays as it is.
    ///
    /// # Errors
    /// [`CrsError::BadOrigin`] when that is no place.
    pub fn with_origin(mut self, geodetic: Vector3<f64>) -> Result<Self, CrsError> {
        let (latitude_deg, longitude_deg, height_m) = (geodetic.x.to_degrees(), geodetic.y.to_degrees(), geodetic.z);
        // NaN fails every comparison and is refused with the rest.
        if !(latitude_deg.abs() <= 90.0 && longitude_deg.abs() <= 360.0 && height_m.abs() < 1e6) {
            return Err(CrsError::BadOrigin { latitude_deg, longitude_deg, height_m });
        }
        if self.kind == CrsKind::Local {
            self.origin = Some(Origin {
                geodetic,
                ecef_m: ecef_from_geodetic(&geodetic),
                ned_from_ecef: ned_from_ecef(geodetic.x, geodetic.y),
            });
        }
        Ok(self)
    }

    /// The same system where map height = ellipsoidal height - `undulation_m`, for strips with physical heights over
    /// an area small enough for a constant.
    #[must_use]
    pub fn with_geoid_undulation_m(mut self, undulation_m: f64) -> Self {
        self.undulation_m = undulation_m;
        self
    }

    /// What it is.
    #[must_use]
    pub fn kind(&self) -> CrsKind {
        self.kind
    }
    /// Its name: the EPSG code, the name in the WKT, or the proj string.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }
    /// EPSG code of the horizontal system, where known.
    #[must_use]
    pub fn epsg(&self) -> Option<u32> {
        self.epsg
    }
    /// Name of the vertical system, where given. It is never applied.
    #[must_use]
    pub fn vertical(&self) -> Option<&str> {
        self.vertical.as_deref()
    }
    /// Latitude \[rad\], longitude \[rad\], height \[m\] of a local system's origin.
    #[must_use]
    pub fn origin(&self) -> Option<Vector3<f64>> {
        self.origin.map(|origin| origin.geodetic)
    }

    /// Easting, northing, height \[m\] of a latitude \[rad\], longitude \[rad\] and ellipsoidal height \[m\].
    ///
    /// # Errors
    /// [`CrsError`] when the system is geographic, has no origin or cannot hold the position.
    pub fn map_from_geodetic(&self, geodetic: &Vector3<f64>) -> Result<Vector3<f64>, CrsError> {
        if self.kind == CrsKind::Local {
            let origin = self.origin.ok_or(CrsError::NoOrigin)?;
            let ned = origin.ned_from_ecef * (ecef_from_geodetic(geodetic) - origin.ecef_m);
            let map = ENU_FROM_NED * ned;
            return Ok(Vector3::new(map.x, map.y, map.z - self.undulation_m));
        }
        let (projection, wgs84) = self.pair()?;
        let mut point = (geodetic.y, geodetic.x, geodetic.z);
        match transform(wgs84, projection, &mut point) {
            // The datum shift moves the height by tens of metres; heights stay as they are.
            Ok(()) if point.0.is_finite() && point.1.is_finite() => {
                Ok(Vector3::new(point.0, point.1, geodetic.z - self.undulation_m))
            }
            _ => Err(self.outside(geodetic.x.to_degrees(), geodetic.y.to_degrees())),
        }
    }

    /// Latitude \[rad\], longitude \[rad\], ellipsoidal height \[m\] of an easting, northing and height \[m\]; the
    /// inverse of [`Crs::map_from_geodetic`] to a micrometre.
    ///
    /// # Errors
    /// As [`Crs::map_from_geodetic`].
    pub fn geodetic_from_map(&self, map_m: &Vector3<f64>) -> Result<Vector3<f64>, CrsError> {
        let height_m = map_m.z + self.undulation_m;
        if self.kind == CrsKind::Local {
            let origin = self.origin.ok_or(CrsError::NoOrigin)?;
            let ned = ENU_FROM_NED * Vector3::new(map_m.x, map_m.y, height_m);
            return Ok(geodetic_from_ecef(&(origin.ecef_m + origin.ned_from_ecef.transpose() * ned)));
        }
        let (projection, wgs84) = self.pair()?;
        let mut geodetic = Vector3::zeros();
        let mut aim = (map_m.x, map_m.y);
        // With a datum shift the inverse needs the height above the other ellipsoid, which nobody has: the miss of
        // the forward formula is taken off until nothing is left.
        for _ in 0..4 {
            let mut point = (aim.0, aim.1, height_m);
            match transform(projection, wgs84, &mut point) {
                Ok(()) if point.0.is_finite() && point.1.is_finite() => {}
                _ => return Err(self.outside(map_m.x, map_m.y)),
            }
            geodetic = Vector3::new(point.1, point.0, height_m);
            let back = self.map_from_geodetic(&geodetic)?;
            let miss = (map_m.x - back.x, map_m.y - back.y);
            if miss.0.abs() + miss.1.abs() < 1e-8 {
                break;
            }
            aim = (aim.0 + miss.0, aim.1 + miss.1);
        }
        Ok(geodetic)
    }

    /// Whether two systems put the same place on the same coordinates: compared by what they do to five points, to
    /// 5 mm. ETRS89 and WGS 84 count as the same, as they do in the headers of most strips.
    #[must_use]
    pub fn is_same(&self, other: &Self) -> bool {
        if self.kind != other.kind {
            return false;
        }
        match self.kind {
            CrsKind::Geographic => true,
            CrsKind::Local => match (self.origin, other.origin) {
                (Some(a), Some(b)) => (a.ecef_m - b.ecef_m).norm() < 5e-3,
                (a, b) => a.is_none() && b.is_none(),
            },
            CrsKind::Projected => self.agrees_on_points(other),
        }
    }

    fn agrees_on_points(&self, other: &Self) -> bool {
        let Some(projection) = &self.projection else { return false };
        let centre = (projection.latitude_of_origin(), projection.longitude_of_origin());
        [(0.0, 0.0), (0.02, 0.02), (-0.02, 0.01), (0.03, -0.02), (-0.01, -0.03)].iter().all(|(dlat, dlon)| {
            // Where the origin is the equator or a pole, look at the middle latitudes that people live in.
            let latitude_rad = if (0.3..1.2).contains(&centre.0.abs()) { centre.0 } else { 0.8 };
            let point = Vector3::new(latitude_rad + dlat, centre.1 + dlon, 100.0);
            match (self.map_from_geodetic(&point), other.map_from_geodetic(&point)) {
                (Ok(a), Ok(b)) => (a.xy() - b.xy()).norm() < 5e-3,
                _ => false,
            }
        })
    }

    /// The projection and WGS 84, or why there is none.
    fn pair(&self) -> Result<(&Proj, &Proj), CrsError> {
        match (&self.projection, &self.wgs84) {
            (Some(projection), Some(wgs84)) if self.kind == CrsKind::Projected => Ok((projection, wgs84)),
            _ => Err(self.geographic()),
        }
    }

    /// The error of a system in degrees.
    pub(super) fn geographic(&self) -> CrsError {
        CrsError::Geographic {
            name: self.name.clone(),
            remedy: "the UTM zone of the place (EPSG:326xx or 258xx)".into(),
        }
    }

    fn outside(&self, first: f64, second: f64) -> CrsError {
        CrsError::OutsideDomain { name: self.name.clone(), first, second }
    }
}
