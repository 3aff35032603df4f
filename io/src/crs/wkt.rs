//! The few things needed from a WKT before it becomes a proj string: its horizontal part, names and codes.

/// Keywords of a projected system, WKT 1 and 2.
const PROJECTED: &[&str] = &["PROJCS", "PROJCRS", "PROJECTEDCRS"];
/// Keywords of a geographic system.
const GEOGRAPHIC: &[&str] = &["GEOGCS", "GEOGCRS", "GEOGRAPHICCRS", "GEODCRS", "GEODETICCRS"];
/// Keywords of a vertical system.
const VERTICAL: &[&str] = &["VERT_CS", "VERTCS", "VERTCRS", "VERTICALCRS"];

/// What a WKT says.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Wkt<'a> {
    /// The text of the projected system, or of the geographic one where there is no projected one.
    pub(super) horizontal: &'a str,
    pub(super) is_projected: bool,
    /// Name of the horizontal system.
    pub(super) name: String,
    /// EPSG code of the horizontal system.
    pub(super) epsg: Option<u32>,
    /// Name of the vertical system.
    pub(super) vertical: Option<String>,
}

/// Reads a WKT; `None` when there is neither a projected nor a geographic system in it.
pub(super) fn read(text: &str) -> Option<Wkt<'_>> {
    let projected = element(text, PROJECTED);
    let horizontal = projected.or_else(|| element(text, GEOGRAPHIC))?;
    Some(Wkt {
        horizontal,
        is_projected: projected.is_some(),
        name: quoted_name(horizontal).unwrap_or_default(),
        epsg: own_epsg(horizontal),
        vertical: element(text, VERTICAL).and_then(quoted_name),
    })
}

/// The first element with one of the keywords, brackets included.
fn element<'a>(text: &'a str, keywords: &[&str]) -> Option<&'a str> {
    let mut quoted = false;
    for (at, c) in text.char_indices() {
        match c {
            '"' => quoted = !quoted,
            '[' | '(' if !quoted => {
                let head = text[..at].trim_end();
                let start = head.rfind(|c: char| !(c.is_ascii_alphanumeric() || c == '_')).map_or(0, |i| i + 1);
                if head.is_char_boundary(start)
                    && keywords.iter().any(|keyword| head[start..].eq_ignore_ascii_case(keyword))
                {
                    return Some(&text[start..closing(text, at)?]);
                }
            }
            _ => {}
        }
    }
    None
}

/// The byte after the bracket that closes the one at `open`.
fn closing(text: &str, open: usize) -> Option<usize> {
    let (mut depth, mut quoted) = (0_usize, false);
    for (at, c) in text[open..].char_indices() {
        match c {
            '"' => quoted = !quoted,
            '[' | '(' if !quoted => depth += 1,
            ']' | ')' if !quoted => {
                depth = depth.checked_sub(1)?;
                if depth == 0 {
                    return Some(open + at + 1);
                }
            }
            _ => {}
        }
    }
    None
}

/// The first quoted text.
fn quoted_name(element: &str) -> Option<String> {
    let mut parts = element.split('"');
    parts.next()?;
    parts.next().map(str::to_string)
}

/// The EPSG code of the element itself, not of a part of it: the last `AUTHORITY` or `ID` at depth one.
fn own_epsg(text: &str) -> Option<u32> {
    let open = text.find(['[', '('])?;
    let (mut depth, mut quoted) = (0_usize, false);
    let mut code = None;
    for (at, c) in text.char_indices().skip_while(|(at, _)| *at < open) {
        match c {
            '"' => quoted = !quoted,
            '[' | '(' if !quoted => {
                let head = text[..at].trim_end();
                let is_id = ["AUTHORITY", "ID"].iter().any(|k| {
                    head.len() > k.len()
                        && head.is_char_boundary(head.len() - k.len())
                        && head[head.len() - k.len()..].eq_ignore_ascii_case(k)
                        && !head[..head.len() - k.len()].ends_with(|c: char| c.is_ascii_alphanumeric() || c == '_')
                });
                if depth == 1
                    && is_id
                    && let Some(end) = closing(text, at)
                {
                    code = epsg_of_id(&text[at..end]).or(code);
                }
                depth += 1;
            }
            ']' | ')' if !quoted => depth = depth.saturating_sub(1),
            _ => {}
        }
    }
    code
}

/// The number of `["EPSG","25832"]` or `["EPSG",25832]`.
fn epsg_of_id(text: &str) -> Option<u32> {
    let mut parts = text.trim_matches(['[', ']', '(', ')']).split(',').map(|p| p.trim().trim_matches('"'));
    parts.next()?.eq_ignore_ascii_case("EPSG").then_some(())?;
    parts.next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const COMPOUND: &str = r#"COMPD_CS["RGF93 / Lambert-93 + NGF-IGN69 height",PROJCS["RGF93 / Lambert-93",
        GEOGCS["RGF93",DATUM["D",SPHEROID["GRS 1980",6378137,298.257222101,AUTHORITY["EPSG","7019"]]],
        AUTHORITY["EPSG","4171"]],PROJECTION["Lambert_Conformal_Conic_2SP"],AUTHORITY["EPSG","2154"]],
        VERT_CS["NGF-IGN69 height",VERT_DATUM["x",2005],AUTHORITY["EPSG","5720"]]]"#;

    #[test]
    fn the_horizontal_part_of_a_compound_system_is_found_with_its_own_code() {
        let wkt = read(COMPOUND).expect("a projected system");
        assert!(wkt.is_projected && wkt.horizontal.starts_with("PROJCS[") && wkt.horizontal.ends_with(']'));
        assert_eq!((wkt.epsg, wkt.name.as_str()), (Some(2154), "RGF93 / Lambert-93"));
        assert_eq!(wkt.vertical.as_deref(), Some("NGF-IGN69 height"));
    }

    #[test]
    fn a_code_in_a_part_is_not_taken_for_the_code_of_the_whole() {
        let wkt =
            read(r#"PROJCRS["x",BASEGEOGCRS["WGS 84",ID["EPSG",4326]],CONVERSION["y",METHOD["z",ID["EPSG",9807]]]]"#);
        assert_eq!(wkt.expect("a projected system").epsg, None);
    }

    #[test]
    fn unbalanced_brackets_are_no_system() {
        assert!(read("PROJCS[\"x\"").is_none());
        assert!(read("]]]]").is_none());
        assert!(read("é[").is_none());
    }
}
