//! The coordinate reference system records of LAS: WKT (2112) and the `GeoTIFF` keys.

use super::bytes::{f64_at, u16_at};

/// Definer of the records.
pub(super) const USER_ID: &str = "LASF_Projection";
/// WKT of a coordinate system. Record 2111, a math transform, is never taken for it.
pub(super) const WKT: u16 = 2112;
/// `GeoKeyDirectoryTag`.
pub(super) const GEO_KEYS: u16 = 34_735;
/// `GeoDoubleParamsTag`.
pub(super) const GEO_DOUBLES: u16 = 34_736;
/// `GeoAsciiParamsTag`.
pub(super) const GEO_ASCII: u16 = 34_737;

/// `GeographicTypeGeoKey`: EPSG code of a geographic system.
const GEOGRAPHIC_TYPE: u16 = 2_048;
/// `ProjectedCSTypeGeoKey`: EPSG code of a projected system.
const PROJECTED_TYPE: u16 = 3_072;

/// The `GeoTIFF` keys of a file, raw.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct GeoKeys {
    /// Key entries: key id, tag location, count, value or index.
    pub keys: Vec<[u16; 4]>,
    /// `GeoDoubleParamsTag`.
    pub doubles: Vec<f64>,
    /// `GeoAsciiParamsTag`; its entries end with `|`.
    pub ascii: String,
}

impl GeoKeys {
    /// Parses the records; entries that the directory promises but does not hold are left out.
    pub(super) fn parse(directory: &[u8], doubles: Option<&[u8]>, ascii: Option<&[u8]>) -> Self {
        let promised = usize::from(u16_at(directory, 6));
        let entries = directory.get(8..).unwrap_or_default().chunks_exact(8).take(promised);
        let entry = |bytes: &[u8]| [u16_at(bytes, 0), u16_at(bytes, 2), u16_at(bytes, 4), u16_at(bytes, 6)];
        Self {
            keys: entries.map(entry).collect(),
            doubles: doubles.unwrap_or_default().chunks_exact(8).map(|bytes| f64_at(bytes, 0)).collect(),
            ascii: wkt_text(ascii.unwrap_or_default()),
        }
    }

    /// The value of a key that is stored in the directory itself.
    #[must_use]
    pub fn short(&self, key_id: u16) -> Option<u16> {
        self.keys.iter().find(|key| key[0] == key_id && key[1] == 0).map(|key| key[3])
    }

    /// EPSG code of the projected, else of the geographic system; `None` for user-defined ones.
    #[must_use]
    pub fn epsg(&self) -> Option<u32> {
        let named = |key_id| self.short(key_id).filter(|code| (1_024..32_767).contains(code)).map(u32::from);
        if self.short(PROJECTED_TYPE).is_some_and(|code| code != 0) {
            return named(PROJECTED_TYPE);
        }
        named(GEOGRAPHIC_TYPE)
    }
}

/// Text of a record up to its first NUL.
pub(super) fn wkt_text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).trim().to_owned()
}

/// EPSG code that a WKT (1 or 2) gives to its projected system, else to its geographic or geocentric one.
///
/// In a compound system the horizontal part is meant; the codes of datum, ellipsoid and units are passed over.
pub(super) fn epsg_of_wkt(wkt: &str) -> Option<u32> {
    let projected = ["PROJCRS", "PROJECTEDCRS", "PROJCS"];
    let geographic = ["GEOGCRS", "GEOGRAPHICCRS", "GEODCRS", "GEODETICCRS", "GEOGCS", "GEOCCS"];
    match projected.iter().find_map(|keyword| node(wkt, keyword)) {
        Some(system) => own_code(system),
        None => geographic.iter().find_map(|keyword| node(wkt, keyword)).and_then(own_code),
    }
}

/// The text after the opening bracket of the first node with this keyword, outside of quoted names.
fn node<'a>(wkt: &'a str, keyword: &str) -> Option<&'a str> {
    let bytes = wkt.as_bytes();
    let mut quoted = false;
    for (index, &byte) in bytes.iter().enumerate() {
        if byte == b'"' {
            quoted = !quoted;
        }
        let is_start = index == 0 || !(bytes[index - 1].is_ascii_alphanumeric() || bytes[index - 1] == b'_');
        let end = index + keyword.len();
        if quoted
            || !is_start
            || !bytes.get(index..end).is_some_and(|word| word.eq_ignore_ascii_case(keyword.as_bytes()))
        {
            continue;
        }
        let rest = wkt.get(end..)?.trim_start();
        if let Some(inside) = rest.strip_prefix(['[', '(']) {
            return Some(inside);
        }
    }
    None
}

/// The EPSG code among the direct children of a node whose contents start here.
fn own_code(contents: &str) -> Option<u32> {
    let mut depth = 0_u32;
    let mut quoted = false;
    for (index, character) in contents.char_indices() {
        match character {
            '"' => quoted = !quoted,
            _ if quoted => {}
            '[' | '(' => depth += 1,
            ']' | ')' if depth == 0 => return None,
            ']' | ')' => depth -= 1,
            ',' if depth == 0 => {
                let child = contents[index + 1..].trim_start();
                if let Some(code) = code_of(child) {
                    return Some(code);
                }
            }
            _ => {}
        }
    }
    None
}

/// `AUTHORITY["EPSG","25832"]` or `ID["EPSG",25832]`.
fn code_of(child: &str) -> Option<u32> {
    let rest = child.strip_prefix("AUTHORITY").or_else(|| child.strip_prefix("ID"))?;
    let inside = rest.trim_start().strip_prefix(['[', '('])?;
    let inside = &inside[..inside.find([']', ')'])?];
    let mut parts = inside.split(',').map(|part| part.trim().trim_matches('"'));
    let is_epsg = parts.next()?.eq_ignore_ascii_case("EPSG");
    if is_epsg { parts.next()?.parse().ok() } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_code_of_a_projected_system_is_its_own_not_its_datum_s() {
        let wkt = r#"PROJCS["ETRS89 / UTM zone 32N",GEOGCS["ETRS89",DATUM["ETRS (PROJCS[)",AUTHORITY["EPSG","6258"]],
            AUTHORITY["EPSG","4258"]],UNIT["metre",1,AUTHORITY["EPSG","9001"]],AUTHORITY["EPSG","25832"]]"#;
        assert_eq!(epsg_of_wkt(wkt), Some(25_832));
    }

    #[test]
    fn a_compound_system_gives_its_horizontal_code() {
        let wkt = r#"COMPD_CS["x",PROJCS["RGF93",GEOGCS["RGF93",AUTHORITY["EPSG","4171"]],AUTHORITY["EPSG","2154"]],
            VERT_CS["NGF",AUTHORITY["EPSG","5720"]],AUTHORITY["EPSG","5698"]]"#;
        assert_eq!(epsg_of_wkt(wkt), Some(2_154));
        assert_eq!(epsg_of_wkt(r#"GEOGCRS["WGS 84",DATUM["d",ID["EPSG",6326]],ID["EPSG",4326]]"#), Some(4_326));
    }

    #[test]
    fn a_projected_system_without_a_code_has_none() {
        assert_eq!(epsg_of_wkt(r#"PROJCS["mine",GEOGCS["WGS 84",AUTHORITY["EPSG","4326"]]]"#), None);
        assert_eq!(epsg_of_wkt("PROJCS["), None);
        assert_eq!(epsg_of_wkt("é]])PROJCS[\"a\",AUTHORITY"), None);
    }

    #[test]
    fn geotiff_keys_give_the_projected_code() {
        let mut directory = Vec::new();
        for value in [1_u16, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 3005] {
            directory.extend(value.to_le_bytes());
        }
        let keys = GeoKeys::parse(&directory, None, None);
        assert_eq!(keys.epsg(), Some(3_005));
        assert_eq!(keys.keys.len(), 2);
        assert_eq!(GeoKeys::parse(&directory[..5], None, None), GeoKeys::default());
    }
}
