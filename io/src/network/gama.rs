//! GNU Gama's input XML (`gama-local`): points, directions, distances, angles, azimuths, height differences, vectors.

use std::collections::HashMap;
use std::f64::consts::PI;
use std::path::Path;

use roxmltree::{Document, Node};

use super::{Fault, Network, NetworkError, Observation, Role, Station, read_text};

/// Reads a `.gkf` file.
///
/// # Errors
/// [`NetworkError`], naming file and line.
pub fn read(path: &Path) -> Result<Network, NetworkError> {
    parse(&read_text(path)?).map_err(|fault| fault.of(path))
}

struct Reader<'a> {
    document: &'a Document<'a>,
    index: HashMap<String, usize>,
    net: Network,
    defaults: HashMap<&'static str, f64>,
}

/// Reads the text of a `.gkf` file.
///
/// # Errors
/// [`Fault`], naming the line.
pub fn parse(text: &str) -> Result<Network, Fault> {
    let document = Document::parse(text)
        .map_err(|e| Fault::new(e.pos().row as usize, format!("this is not well-formed XML: {e}")))?;
    let mut reader =
        Reader { document: &document, index: HashMap::new(), net: Network::default(), defaults: HashMap::new() };
    reader.net.sigma_apriori = 10.0;
    reader.net.a_posteriori = true;
    let root = document.root_element();
    let network = root
        .children()
        .find(|n| n.has_tag_name_local("network"))
        .ok_or_else(|| Fault::new(1, "there is no <network>; is this a gama-local file?"))?;
    reader.axes(&network)?;
    let is_point = |n: &Node<'_, '_>| n.is_element() && n.tag_name().name() == "point";
    for point in network.descendants().filter(is_point) {
        reader.point(&point)?;
    }
    for node in network.children().filter(Node::is_element) {
        match node.tag_name().name() {
            "parameters" => reader.parameters(&node)?,
            "points-observations" => {
                for name in ["distance-stdev", "direction-stdev", "angle-stdev", "azimuth-stdev"] {
                    if let Some(value) = node.attribute(name) {
                        let first = value.split_whitespace().next().unwrap_or("");
                        let number = reader.number(&node, name, first)?;
                        reader.defaults.insert(name, number);
                    }
                }
                for child in node.children().filter(Node::is_element) {
                    reader.group(&child)?;
                }
            }
            _ => {}
        }
    }
    if reader.net.stations.is_empty() {
        return Err(Fault::new(1, "there is no <point> in the net"));
    }
    Ok(reader.net)
}

trait Local {
    fn has_tag_name_local(&self, name: &str) -> bool;
}
impl Local for Node<'_, '_> {
    fn has_tag_name_local(&self, name: &str) -> bool {
        self.is_element() && self.tag_name().name() == name
    }
}

impl Reader<'_> {
    fn line(&self, node: &Node<'_, '_>) -> usize {
        self.document.text_pos_at(node.range().start).row as usize
    }
    fn fault(&self, node: &Node<'_, '_>, message: impl Into<String>) -> Fault {
        Fault::new(self.line(node), message)
    }
    fn number(&self, node: &Node<'_, '_>, what: &str, word: &str) -> Result<f64, Fault> {
        let number = word.trim().parse::<f64>().ok().filter(|v| v.is_finite());
        number.ok_or_else(|| self.fault(node, format!("{what}: `{word}` is not a finite number")))
    }
    fn attribute<'n>(&self, node: &Node<'n, '_>, name: &str) -> Result<&'n str, Fault> {
        node.attribute(name).ok_or_else(|| self.fault(node, format!("<{}> needs `{name}`", node.tag_name().name())))
    }
    /// A value in metres.
    fn length(&self, node: &Node<'_, '_>, name: &str) -> Result<f64, Fault> {
        self.number(node, name, self.attribute(node, name)?)
    }
    /// An angle \[rad\] in gon, or in degrees with minus signs between degrees, minutes and seconds; whether the
    /// latter.
    fn angle(&self, node: &Node<'_, '_>) -> Result<(f64, bool), Fault> {
        let word = self.attribute(node, "val")?.trim();
        let body = word.trim_start_matches('-');
        if body.contains('-') && !body.contains("e-") {
            let parts: Vec<f64> = body.split('-').map(|p| self.number(node, "val", p)).collect::<Result<_, _>>()?;
            let degrees = parts.iter().zip([1.0, 60.0, 3600.0]).map(|(p, d)| p / d).sum::<f64>();
            let sign = if word.starts_with('-') { -1.0 } else { 1.0 };
            return Ok((sign * degrees.to_radians(), true));
        }
        Ok((self.number(node, "val", word)? * PI / 200.0, false))
    }
    /// A standard deviation in the file's unit.
    fn sigma(&self, node: &Node<'_, '_>, default: &str) -> Result<f64, Fault> {
        let sigma = match node.attribute("stdev") {
            Some(word) => self.number(node, "stdev", word)?,
            None => *self.defaults.get(default).ok_or_else(|| {
                self.fault(node, format!("<{}> has no `stdev`, and there is no `{default}`", node.tag_name().name()))
            })?,
        };
        if sigma > 0.0 { Ok(sigma) } else { Err(self.fault(node, format!("`stdev` must be above 0, not {sigma}"))) }
    }
    /// Sigma of an angle \[rad\]: in cc, or in seconds where the value is in degrees.
    fn angle_sigma(&self, node: &Node<'_, '_>, default: &str, degrees: bool) -> Result<f64, Fault> {
        Ok(self.sigma(node, default)? * if degrees { PI / 648_000.0 } else { PI / 2_000_000.0 })
    }
    fn station(&self, node: &Node<'_, '_>, name: &str) -> Result<usize, Fault> {
        let word = self.attribute(node, name)?;
        self.find(node, word)
    }
    fn find(&self, node: &Node<'_, '_>, word: &str) -> Result<usize, Fault> {
        self.index.get(word.trim()).copied().ok_or_else(|| {
            self.fault(node, format!("point `{word}` is nowhere in the file; add a <point> or drop the observation"))
        })
    }

    fn axes(&mut self, node: &Node<'_, '_>) -> Result<(), Fault> {
        let axes = node.attribute("axes-xy").unwrap_or("ne");
        let clockwise = node.attribute("angles").unwrap_or("left-handed") == "left-handed";
        // azimuth clockwise from north, in quarters of a turn
        let quarter = |c: char| "nesw".find(c).map(|q| u8::try_from(q).unwrap_or(0));
        let mut letters = axes.chars();
        let (Some(x), Some(y)) = (letters.next().and_then(quarter), letters.next().and_then(quarter)) else {
            return Err(self.fault(node, format!("axes-xy: `{axes}` is not a pair of n, s, e, w")));
        };
        let y_is_clockwise = (x + 1) % 4 == y;
        self.net.angles_from_y_to_x = y_is_clockwise != clockwise;
        let azimuth = f64::from(x) * PI / 2.0;
        self.net.azimuth_of_x_rad = if clockwise { azimuth } else { -azimuth };
        Ok(())
    }

    fn parameters(&mut self, node: &Node<'_, '_>) -> Result<(), Fault> {
        if let Some(word) = node.attribute("sigma-apr") {
            let sigma = self.number(node, "sigma-apr", word)?;
            if sigma <= 0.0 {
                return Err(self.fault(node, "`sigma-apr` must be above 0"));
            }
            self.net.sigma_apriori = sigma;
        }
        self.net.a_posteriori = node.attribute("sigma-act").unwrap_or("aposteriori") != "apriori";
        Ok(())
    }

    fn point(&mut self, node: &Node<'_, '_>) -> Result<(), Fault> {
        let name = self.attribute(node, "id")?.trim().to_string();
        let mut coordinates_m = [None; 3];
        for (k, axis) in ["x", "y", "z"].iter().enumerate() {
            if let Some(word) = node.attribute(*axis) {
                coordinates_m[k] = Some(self.number(node, axis, word)?);
            }
        }
        let mut roles = [Role::None; 3];
        for (word, fixed) in [(node.attribute("fix"), true), (node.attribute("adj"), false)] {
            for letter in word.unwrap_or("").chars() {
                let Some(k) = "xyz".find(letter.to_ascii_lowercase()) else {
                    return Err(self.fault(node, format!("`{letter}` is not a coordinate")));
                };
                roles[k] = match (fixed, letter.is_uppercase()) {
                    (true, _) => Role::Fixed,
                    (false, true) => Role::Constrained,
                    (false, false) => Role::Adjusted,
                };
            }
        }
        if self.index.insert(name.clone(), self.net.stations.len()).is_some() {
            return Err(self.fault(node, format!("point `{name}` was there before")));
        }
        self.net.stations.push(Station { name, coordinates_m, roles });
        Ok(())
    }

    fn group(&mut self, node: &Node<'_, '_>) -> Result<(), Fault> {
        match node.tag_name().name() {
            "obs" | "height-differences" => {
                let mut has_directions = false;
                for child in node.children().filter(Node::is_element) {
                    has_directions |= child.tag_name().name() == "direction";
                    if child.tag_name().name() == "cov-mat" {
                        return Err(self.fault(&child, "correlated terrestrial observations are not supported"));
                    }
                    self.observation(node, &child)?;
                }
                self.net.sets += usize::from(has_directions);
                Ok(())
            }
            "vectors" => self.vectors(node),
            "point" => Ok(()),
            other => Err(self.fault(node, format!("<{other}> is not supported"))),
        }
    }

    fn observation(&mut self, group: &Node<'_, '_>, node: &Node<'_, '_>) -> Result<(), Fault> {
        let from = match (node.attribute("from"), group.attribute("from")) {
            (Some(word), _) | (None, Some(word)) => self.find(node, word)?,
            (None, None) => return Err(self.fault(node, "the observation has no `from`")),
        };
        let observation = match node.tag_name().name() {
            "direction" => {
                let (value, degrees) = self.angle(node)?;
                let sigma = self.angle_sigma(node, "direction-stdev", degrees)?;
                Observation::Direction(self.net.sets, from, self.station(node, "to")?, value, sigma)
            }
            "distance" => {
                let sigma = self.sigma(node, "distance-stdev")? * 1e-3;
                Observation::Distance(from, self.station(node, "to")?, self.length(node, "val")?, sigma)
            }
            "angle" => {
                let (value, degrees) = self.angle(node)?;
                let sigma = self.angle_sigma(node, "angle-stdev", degrees)?;
                Observation::Angle(from, self.station(node, "bs")?, self.station(node, "fs")?, value, sigma)
            }
            "azimuth" => {
                let (value, degrees) = self.angle(node)?;
                let sigma = self.angle_sigma(node, "azimuth-stdev", degrees)?;
                Observation::Azimuth(from, self.station(node, "to")?, value, sigma)
            }
            "dh" => {
                let sigma = self.sigma(node, "dh-stdev")? * 1e-3;
                Observation::HeightDifference(from, self.station(node, "to")?, self.length(node, "val")?, sigma)
            }
            other => return Err(self.fault(node, format!("<{other}> is not supported"))),
        };
        self.net.observations.push(observation);
        Ok(())
    }

    fn vectors(&mut self, node: &Node<'_, '_>) -> Result<(), Fault> {
        let mut members = Vec::new();
        for vec in node.children().filter(|n| n.has_tag_name_local("vec")) {
            let d = [self.length(&vec, "dx")?, self.length(&vec, "dy")?, self.length(&vec, "dz")?];
            members.push((Some(self.station(&vec, "from")?), self.station(&vec, "to")?, d));
        }
        let n = 3 * members.len();
        let matrix = node
            .children()
            .find(|c| c.has_tag_name_local("cov-mat"))
            .ok_or_else(|| self.fault(node, "<vectors> needs a <cov-mat>"))?;
        let band = self.number(&matrix, "band", self.attribute(&matrix, "band")?)?;
        let numbers: Vec<f64> = matrix
            .text()
            .unwrap_or("")
            .split_whitespace()
            .map(|w| self.number(&matrix, "cov-mat", w))
            .collect::<Result<_, _>>()?;
        let mut covariance = vec![0.0; n * n];
        let mut next = numbers.into_iter();
        for r in 0..n {
            #[allow(clippy::cast_precision_loss)] // a band is small
            for c in (r..n).take_while(|c| (c - r) as f64 <= band) {
                let value = next.next().ok_or_else(|| self.fault(&matrix, "the <cov-mat> has too few numbers"))?;
                // mm² in the file
                covariance[r * n + c] = value * 1e-6;
                covariance[c * n + r] = value * 1e-6;
            }
        }
        self.net.observations.push(Observation::Cluster(members, covariance));
        Ok(())
    }
}
