//! From an EPSG code, WKT, a proj string or the `GeoKeys` of a LAS file to a [`Crs`].

use proj4rs::Proj;

use super::error::CrsError;
use super::projection::{Crs, CrsKind};
use super::wkt;

/// `GeoKey` numbers of `GeoTIFF`, as LAS uses them.
const KEY_GEOGRAPHIC: u16 = 2048;
const KEY_PROJECTED: u16 = 3072;
const KEY_VERTICAL: u16 = 4096;
/// The value for "defined by other keys".
const USER_DEFINED: u16 = 32_767;

impl Crs {
    /// A system of `"EPSG:2056"`, `"EPSG:25832+7837"` (the part after the plus is vertical), WKT 1 or 2, a proj string
    /// (`"+proj=utm +zone=32 …"`), or `"local"`.
    ///
    /// # Errors
    /// [`CrsError`] says what was not understood and what to write instead.
    pub fn parse(text: &str) -> Result<Self, CrsError> {
        let text = text.trim().trim_end_matches('\0').trim();
        if text.eq_ignore_ascii_case("local") {
            return Ok(Self::local_without_origin());
        }
        if text.contains("+proj") || text.contains("proj=") && !text.contains('[') {
            return Self::from_proj_string(text, text, None);
        }
        if text.contains(['[', '(']) {
            return Self::from_wkt(text);
        }
        let not_understood = || CrsError::NotUnderstood { text: beginning(text) };
        let code = text
            .get(..5)
            .filter(|head| head.eq_ignore_ascii_case("EPSG:"))
            .map(|_| &text[5..])
            .or_else(|| text.strip_prefix("urn:ogc:def:crs:EPSG:").and_then(|rest| rest.rsplit(':').next()))
            .ok_or_else(not_understood)?;
        let (horizontal, vertical) = match code.split_once('+') {
            Some((horizontal, vertical)) => {
                let vertical = vertical.trim();
                let vertical = vertical.strip_prefix("EPSG:").unwrap_or(vertical);
                let number: u32 = vertical.parse().map_err(|_| not_understood())?;
                (horizontal, Some(format!("EPSG:{number}")))
            }
            None => (code, None),
        };
        let mut crs = Self::from_epsg(horizontal.trim().parse().map_err(|_| not_understood())?)?;
        crs.vertical = vertical;
        Ok(crs)
    }

    /// The system of an EPSG code.
    ///
    /// # Errors
    /// [`CrsError::UnknownCode`], or as [`Crs::parse`].
    pub fn from_epsg(code: u32) -> Result<Self, CrsError> {
        let definition = u16::try_from(code)
            .ok()
            .and_then(crs_definitions::from_code)
            .filter(|definition| !definition.proj4.trim().is_empty())
            .ok_or(CrsError::UnknownCode { code })?;
        Self::from_proj_string(definition.proj4, &format!("EPSG:{code}"), Some(code))
    }

    /// The system of a `GeoKeyDirectory` record of a LAS file (user id `LASF_Projection`, record 34735).
    /// `None` when no EPSG code is in it.
    ///
    /// # Errors
    /// As [`Crs::from_epsg`].
    pub fn from_geokeys(directory: &[u8]) -> Result<Option<Self>, CrsError> {
        let numbers: Vec<u16> = directory.as_chunks::<2>().0.iter().map(|bytes| u16::from_le_bytes(*bytes)).collect();
        // Four numbers a key: id, where the value is (0: here), count, value. The first four are the head.
        let key = |id: u16| {
            let found = numbers.as_chunks::<4>().0.iter().skip(1).find(|k| k[0] == id && k[1] == 0)?;
            (found[3] != 0 && found[3] != USER_DEFINED).then_some(u32::from(found[3]))
        };
        let Some(code) = key(KEY_PROJECTED).or_else(|| key(KEY_GEOGRAPHIC)) else { return Ok(None) };
        let mut crs = Self::from_epsg(code)?;
        crs.vertical = key(KEY_VERTICAL).map(|vertical| format!("EPSG:{vertical}"));
        Ok(Some(crs))
    }

    fn from_wkt(text: &str) -> Result<Self, CrsError> {
        let wkt = wkt::read(text).ok_or_else(|| CrsError::NotUnderstood { text: beginning(text) })?;
        // The list of definitions knows datum shifts that most WKT leave out.
        let mut crs = match wkt.epsg.map(Self::from_epsg) {
            Some(Ok(crs)) => crs,
            Some(Err(error @ (CrsError::NotMetric { .. } | CrsError::Axes { .. }))) => return Err(error),
            _ => {
                let proj_string = proj4wkt::wkt_to_projstring(wkt.horizontal).map_err(|error| {
                    CrsError::Unsupported { text: beginning(wkt.horizontal), reason: error.to_string() }
                })?;
                Self::from_proj_string(&proj_string, &wkt.name, wkt.epsg)?
            }
        };
        if !wkt.name.is_empty() {
            crs.name.clone_from(&wkt.name);
        }
        crs.vertical = wkt.vertical;
        Ok(crs)
    }

    fn from_proj_string(text: &str, name: &str, epsg: Option<u32>) -> Result<Self, CrsError> {
        let parameter = |key: &str| {
            let words = || text.split_whitespace().map(|word| word.trim_start_matches('+'));
            words().find_map(|word| word.strip_prefix(key)?.strip_prefix('=')).map(str::to_string)
        };
        let name = name.to_string();
        if !text.is_ascii() {
            // proj4rs cuts angles at bytes and panics inside of a character.
            return Err(CrsError::NotUnderstood { text: beginning(text) });
        }
        // LAS holds easting first whatever the definition prefers; west and south cannot be undone by order.
        if let Some(axes) = parameter("axis").filter(|axes| !matches!(axes.as_str(), "enu" | "neu")) {
            return Err(CrsError::Axes { name, axes });
        }
        let plain: Vec<&str> =
            text.split_whitespace().filter(|word| !word.trim_start_matches('+').starts_with("axis=")).collect();
        let proj_string = plain.join(" ");
        let unsupported = |reason: String| CrsError::Unsupported { text: beginning(text), reason };
        let projection = Proj::from_proj_string(&proj_string).map_err(|e| unsupported(e.to_string()))?;
        let wgs84 =
            Proj::from_proj_string("+proj=longlat +datum=WGS84 +no_defs").map_err(|e| unsupported(e.to_string()))?;
        if projection.is_geocent() {
            return Err(unsupported("Cartesian coordinates are no map".into()));
        }
        let kind = if projection.is_latlong() { CrsKind::Geographic } else { CrsKind::Projected };
        if kind == CrsKind::Projected && (projection.to_meter() - 1.0).abs() > 1e-12 {
            let units = parameter("units").or_else(|| parameter("to_meter")).unwrap_or_default();
            return Err(CrsError::NotMetric { name, units });
        }
        Ok(Self {
            name,
            kind,
            epsg,
            vertical: None,
            proj_string,
            projection: Some(projection),
            wgs84: Some(wgs84),
            origin: None,
            undulation_m: 0.0,
        })
    }
}

/// The beginning of a long text.
fn beginning(text: &str) -> String {
    let mut short: String = text.chars().take(120).collect();
    if short.len() < text.len() {
        short.push('…');
    }
    short
}
