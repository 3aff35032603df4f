//! A geodetic net as a problem, and its solution.

use anyhow::{Result, bail};
use nalgebra::{DMatrix, Vector2, Vector3};
use tieline_graph::factor::baseline::Cluster;
use tieline_graph::factor::terrestrial::{Angle, Azimuth, Direction, Distance, HeightDifference};
use tieline_graph::{Kind, Problem, VariableId};
use tieline_io::network::{Network, Observation, Role};

use super::approximate;

/// A net as a problem.
#[derive(Debug)]
pub struct GeodeticNet {
    /// The net of the file.
    pub net: Network,
    /// Variables and factors.
    pub problem: Problem,
    /// Place of each station: x and y or x, y and z.
    pub places: Vec<Option<VariableId>>,
    /// Height of each station where it stands alone.
    pub heights: Vec<Option<VariableId>>,
    /// Coordinates that carry the datum of a free net.
    pub datum: Vec<(VariableId, usize)>,
}

impl GeodeticNet {
    /// Makes the problem of a net; computes approximate coordinates that are missing.
    ///
    /// # Errors
    /// When a station has no coordinates and no observation gives any, or roles are mixed in a way that is not
    /// supported.
    pub fn new(net: Network) -> Result<Self> {
        let mut this =
            Self { problem: Problem::new(), places: Vec::new(), heights: Vec::new(), datum: Vec::new(), net };
        this.stations()?;
        this.observations()?;
        Ok(this)
    }

    /// Sign of y: angles run from x to y inside.
    fn y_sign(&self) -> f64 {
        if self.net.angles_from_y_to_x { -1.0 } else { 1.0 }
    }

    fn stations(&mut self) -> Result<()> {
        let sign = self.y_sign();
        let in_space = self.net.observations.iter().any(|o| matches!(o, Observation::Cluster(..)));
        let mut plane: Vec<Option<Vector2<f64>>> = self
            .net
            .stations
            .iter()
            .map(|s| Some(Vector2::new(s.coordinates_m[0]?, sign * s.coordinates_m[1]?)))
            .collect();
        if !in_space {
            approximate::complete(&self.net, &mut plane);
        }
        let stations = self.net.stations.clone();
        for (station, place) in stations.iter().zip(plane) {
            let [x, y, z] = station.roles;
            let (mut at, mut height) = (None, None);
            if in_space {
                let [Some(cx), Some(cy), Some(cz)] = station.coordinates_m else {
                    bail!("station `{}` needs approximate x, y and z", station.name);
                };
                let id = self.problem.add_variable(Kind::Point3, &[cx, sign * cy, cz]);
                self.role(id, &station.name, &[x, y, z])?;
                at = Some(id);
            } else {
                if x != Role::None || y != Role::None {
                    let Some(p) = place else {
                        bail!(
                            "station `{}` has no coordinates, and the observations give none: add x and y",
                            station.name
                        );
                    };
                    let id = self.problem.add_variable(Kind::Point2, &[p.x, p.y]);
                    self.role(id, &station.name, &[x, y])?;
                    at = Some(id);
                }
                if z != Role::None {
                    // levelled heights are linear: any start will do
                    let id = self.problem.add_variable(Kind::Height, &[station.coordinates_m[2].unwrap_or(0.0)]);
                    if let Some(p) = place {
                        self.problem.set_place(id, [p.x, p.y, 0.0]);
                    }
                    self.role(id, &station.name, &[z])?;
                    height = Some(id);
                }
            }
            self.places.push(at);
            self.heights.push(height);
        }
        Ok(())
    }

    fn role(&mut self, id: VariableId, name: &str, roles: &[Role]) -> Result<()> {
        self.problem.set_name(id, name);
        let fixed = roles.iter().filter(|r| **r == Role::Fixed).count();
        if fixed == roles.len() {
            self.problem.fix(id);
        } else if fixed > 0 || roles.contains(&Role::None) {
            bail!("station `{name}`: coordinates of one place must all be fixed or all be adjusted");
        }
        for (component, role) in roles.iter().enumerate() {
            if *role == Role::Constrained {
                self.datum.push((id, component));
            }
        }
        Ok(())
    }

    fn place(&self, station: usize) -> Result<VariableId> {
        match self.places[station] {
            Some(id) => Ok(id),
            None => bail!(
                "station `{}` is observed but neither fixed nor adjusted in x and y",
                self.net.stations[station].name
            ),
        }
    }
    fn height(&self, station: usize) -> Result<VariableId> {
        match self.heights[station] {
            Some(id) => Ok(id),
            None => {
                bail!("station `{}` is levelled but neither fixed nor adjusted in z", self.net.stations[station].name)
            }
        }
    }

    fn observations(&mut self) -> Result<()> {
        let observations = std::mem::take(&mut self.net.observations);
        let sign = self.y_sign();
        let mut oriented: Vec<(f64, f64, usize)> = vec![(0.0, 0.0, 0); self.net.sets];
        for observation in &observations {
            if let Observation::Direction(set, from, to, value, _) = observation {
                let d = self.problem.values.xy(self.place(*to)?) - self.problem.values.xy(self.place(*from)?);
                let (sin, cos) = (d.y.atan2(d.x) - value).sin_cos();
                let sum = &mut oriented[*set];
                *sum = (sum.0 + sin, sum.1 + cos, *from);
            }
        }
        let mut sets = Vec::with_capacity(oriented.len());
        for (sin, cos, station) in oriented {
            let host = self.place(station)?;
            let zero = [sin.atan2(cos)];
            // a held station has no node to go with
            let id = if self.problem.is_fixed(host) {
                let id = self.problem.add_variable(Kind::Scalar, &zero);
                if let Some(place) = self.problem.place(host) {
                    self.problem.set_place(id, place);
                }
                id
            } else {
                self.problem.add_attached(host, Kind::Scalar, &zero)
            };
            self.problem.set_name(id, format!("orientation at {}", self.net.stations[station].name));
            sets.push(id);
        }
        let north = self.net.azimuth_of_x_rad;
        for observation in &observations {
            match observation {
                Observation::Direction(set, from, to, value, sigma) => {
                    let ids = [self.place(*from)?, self.place(*to)?, sets[*set]];
                    self.problem.add(Direction::new(ids, *value, *sigma));
                }
                Observation::Distance(a, b, value, sigma) => {
                    self.problem.add(Distance::new([self.place(*a)?, self.place(*b)?], *value, *sigma));
                }
                Observation::Angle(at, back, fore, value, sigma) => {
                    let ids = [self.place(*at)?, self.place(*back)?, self.place(*fore)?];
                    self.problem.add(Angle::new(ids, *value, *sigma));
                }
                Observation::Azimuth(a, b, value, sigma) => {
                    let ids = [self.place(*a)?, self.place(*b)?];
                    self.problem.add(Azimuth::new(ids, value - north, *sigma));
                }
                Observation::HeightDifference(a, b, value, sigma) => {
                    let ids = [self.height(*a)?, self.height(*b)?];
                    self.problem.add(HeightDifference::new(ids, *value, *sigma));
                }
                Observation::Cluster(members, covariance) => self.cluster(members, covariance, sign)?,
            }
        }
        self.net.observations = observations;
        Ok(())
    }

    fn cluster(&mut self, members: &[(Option<usize>, usize, [f64; 3])], covariance: &[f64], sign: f64) -> Result<()> {
        let n = 3 * members.len();
        let flip = |k: usize| if k % 3 == 1 { sign } else { 1.0 };
        let matrix = DMatrix::from_fn(n, n, |r, c| covariance[r * n + c] * flip(r) * flip(c));
        let mut list = Vec::with_capacity(members.len());
        for (a, b, v) in members {
            let from = a.map(|a| self.place(a)).transpose()?;
            list.push((from, self.place(*b)?, Vector3::new(v[0], sign * v[1], v[2])));
        }
        match Cluster::new(&list, &matrix) {
            Ok(cluster) => self.problem.add(cluster),
            Err(error) => bail!("a cluster to `{}`: the covariance: {error}", self.net.stations[members[0].1].name),
        }
        Ok(())
    }

    /// Adjusted coordinates of a station as the file counts them \[m\].
    #[must_use]
    pub fn coordinates_m(&self, station: usize) -> [Option<f64>; 3] {
        let mut out = [None; 3];
        if let Some(id) = self.places[station] {
            let v = self.problem.values.get(id);
            out[0] = Some(v[0]);
            out[1] = Some(self.y_sign() * v[1]);
            out[2] = v.get(2).copied();
        }
        if let Some(id) = self.heights[station] {
            out[2] = Some(self.problem.values.scalar(id));
        }
        out
    }
}
