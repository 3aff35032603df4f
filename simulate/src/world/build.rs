//! Puts the world together from the options and the seed.

use nalgebra::{Vector2, Vector3};

use super::index::Index;
use super::solid::House;
use super::{ROAD_HALF_WIDTH_M, Road, Roof, Solid, Terrain, Tree, World};
use crate::random::Random;
use crate::scenario::{Area, WorldOptions};

/// Attempts to find room for a thing.
const ATTEMPTS: u32 = 60;
/// Distance between parallel roads \[m\].
const ROAD_SPACING_M: f64 = 95.0;
/// Free ground about a house \[m\].
const GARDEN_M: f64 = 1.5;

impl World {
    /// The world of a seed; `strips` is the number of strips that cars may be in.
    pub(crate) fn new(seed: u64, area: &Area, options: &WorldOptions, strips: u32) -> Self {
        let half_m = Vector2::new(area.east_m, area.north_m) * 0.5;
        let mut builder = Builder {
            half_m,
            terrain: Terrain::new(seed, options.relief_m),
            roads: roads(seed, half_m),
            solids: Vec::new(),
            trees: Vec::new(),
        };
        let mut random = Random::new(seed, &[2]);
        for _ in 0..options.buildings {
            builder.add_house(&mut random);
        }
        for _ in 0..options.trees {
            builder.add_tree(&mut random);
        }
        for _ in 0..options.moving_objects {
            builder.add_car(&mut random, strips);
        }
        builder.finish(options.ground_roughness_m)
    }
}

/// Two families of parallel roads.
fn roads(seed: u64, half_m: Vector2<f64>) -> Vec<Road> {
    let mut random = Random::new(seed, &[3]);
    let turn = random.between(-0.3, 0.3);
    let mut roads = Vec::new();
    for family in 0..2 {
        let angle = turn + f64::from(family) * (std::f64::consts::FRAC_PI_2 + random.between(-0.1, 0.1));
        let normal = Vector2::new(angle.cos(), angle.sin());
        let reach = half_m.norm();
        let mut offset_m = -reach + random.between(0.0, ROAD_SPACING_M);
        while offset_m < reach {
            roads.push(Road { normal, offset_m });
            offset_m += ROAD_SPACING_M * random.between(0.8, 1.2);
        }
    }
    roads
}

struct Builder {
    half_m: Vector2<f64>,
    terrain: Terrain,
    roads: Vec<Road>,
    solids: Vec<Solid>,
    trees: Vec<Tree>,
}

impl Builder {
    /// A place within the area where a circle touches neither road, house nor tree.
    fn free_place(&self, random: &mut Random, radius_m: f64) -> Option<Vector2<f64>> {
        let inside = self.half_m - Vector2::repeat(radius_m);
        (0..ATTEMPTS).find_map(|_| {
            let place = Vector2::new(random.between(-inside.x, inside.x), random.between(-inside.y, inside.y));
            let off_road = |road: &Road| (road.normal.dot(&place) - road.offset_m).abs() > ROAD_HALF_WIDTH_M + radius_m;
            let off_house = |s: &Solid| (s.centre - place).norm() > s.radius_m + radius_m;
            let off_tree = |t: &Tree| (t.foot() - place).norm() > t.radius_m + radius_m;
            (self.roads.iter().all(off_road) && self.solids.iter().all(off_house) && self.trees.iter().all(off_tree))
                .then_some(place)
        })
    }

    fn add_house(&mut self, random: &mut Random) {
        let half_width_m = random.between(3.5, 6.5);
        let half_length_m = half_width_m * random.between(1.1, 2.2);
        let Some(centre) = self.free_place(random, half_length_m.hypot(half_width_m) + GARDEN_M) else { return };
        let roof = match random.below(5) {
            0 => Roof::Flat,
            1 | 2 => Roof::Hip,
            _ => Roof::Gable,
        };
        let house = House {
            centre,
            azimuth_rad: random.between(0.0, std::f64::consts::PI),
            half_length_m,
            half_width_m,
            base_m: self.terrain.height(centre.x, centre.y).0,
            eaves_m: random.between(3.0, 8.0),
            roof,
            slope_rad: random.between(18.0, 45.0).to_radians(),
            reflectance: random.between(0.2, 0.7),
        };
        self.solids.push(Solid::house(&house));
    }

    fn add_tree(&mut self, random: &mut Random) {
        let (radius_m, half_height_m) = (random.between(1.5, 3.5), random.between(2.0, 4.5));
        let Some(place) = self.free_place(random, radius_m) else { return };
        let ground_m = self.terrain.height(place.x, place.y).0;
        let centre = Vector3::new(place.x, place.y, ground_m + random.between(2.0, 4.0) + half_height_m);
        self.trees.push(Tree { centre, radius_m, half_height_m });
    }

    /// A car on a road, there in one strip only.
    fn add_car(&mut self, random: &mut Random, strips: u32) {
        if self.roads.is_empty() || strips == 0 {
            return;
        }
        let road = self.roads[usize::try_from(random.below(self.roads.len() as u64)).unwrap_or(0)];
        let along = Vector2::new(-road.normal.y, road.normal.x);
        let reach = self.half_m.min();
        let side = if random.uniform() < 0.5 { 1.6 } else { -1.6 };
        let centre = road.normal * (road.offset_m + side) + along * random.between(-reach, reach);
        if centre.x.abs() > self.half_m.x || centre.y.abs() > self.half_m.y {
            return;
        }
        let house = House {
            centre,
            azimuth_rad: along.y.atan2(along.x),
            half_length_m: random.between(1.9, 2.6),
            half_width_m: random.between(0.8, 1.0),
            base_m: self.terrain.height(centre.x, centre.y).0,
            eaves_m: random.between(1.3, 2.2),
            roof: Roof::Flat,
            slope_rad: 0.0,
            reflectance: random.between(0.1, 0.8),
        };
        let mut car = Solid::house(&house);
        car.only_strip = u32::try_from(random.below(u64::from(strips))).ok();
        self.solids.push(car);
    }

    fn finish(self, roughness_m: f64) -> World {
        let (mut solid_index, mut tree_index) = (Index::new(self.half_m), Index::new(self.half_m));
        for (number, solid) in (0..).zip(&self.solids) {
            solid_index.add(number, solid.centre, solid.radius_m + Index::MARGIN_M);
        }
        for (number, tree) in (0..).zip(&self.trees) {
            tree_index.add(number, tree.foot(), tree.radius_m + Index::MARGIN_M);
        }
        let roofs = self.solids.iter().map(|s| s.top_m);
        let crowns = self.trees.iter().map(|t| t.centre.z + t.half_height_m);
        let highest_m = roofs.chain(crowns).fold(self.terrain.highest_m(), f64::max);
        World {
            terrain: self.terrain,
            solids: self.solids,
            trees: self.trees,
            roads: self.roads,
            solid_index,
            tree_index,
            highest_m,
            roughness_m,
        }
    }
}
