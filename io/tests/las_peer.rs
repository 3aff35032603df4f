//! The las crate as a peer: it reads what is written here, and what it writes is read here, attribute by attribute.

#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss
)]

use tieline_io::las::{Columns, LasFile, LasWriter, LasWriterOptions};

fn points(count: u32) -> Columns {
    let mut columns = Columns::default();
    for i in 0..count {
        let wave = f64::from(i) * 0.37;
        columns.x.push((1_000.0 * wave.sin()) as i32 + i as i32);
        columns.y.push((900.0 * wave.cos()) as i32 - i as i32);
        columns.z.push((i % 701) as i32);
        columns.gps_time.push(3.0e8 + f64::from(i) * 1e-4);
        columns.intensity.push((i % 4_096) as u16);
        columns.return_number.push((i % 3 + 1) as u8);
        columns.number_of_returns.push(3);
        columns.classification.push((i % 19) as u8);
        columns.flags.push(0);
        columns.scanner_channel.push((i % 2) as u8);
        columns.scan_angle_deg.push(((i % 61) as f32 - 30.0) * 0.6);
        columns.user_data.push((i % 251) as u8);
        columns.point_source_id.push((i % 7) as u16);
    }
    columns
}

#[test]
fn the_las_crate_reads_every_attribute_of_a_file_written_here() {
    let folder = tempfile::tempdir().unwrap();
    let written = points(70_000);
    for (name, point_format) in [("a.laz", 6), ("b.las", 6), ("c.laz", 1)] {
        let path = folder.path().join(name);
        let options = LasWriterOptions { point_format, ..LasWriterOptions::default() };
        let mut writer = LasWriter::create(&path, options).unwrap();
        writer.write(&written).unwrap();
        let header = writer.finish().unwrap();
        let mut reader = las::Reader::from_path(&path).unwrap();
        assert_eq!(reader.header().number_of_points(), 70_000);
        assert!((reader.header().bounds().max.z - header.max[2]).abs() < 1e-9);
        let theirs = reader.read_all().unwrap();
        assert!(theirs.x_raw().eq(written.x.iter().copied()));
        assert!(theirs.y_raw().eq(written.y.iter().copied()) && theirs.z_raw().eq(written.z.iter().copied()));
        assert!(theirs.gps_time().unwrap().map(f64::to_bits).eq(written.gps_time.iter().map(|t| t.to_bits())));
        assert!(theirs.intensity().eq(written.intensity.iter().copied()));
        assert!(theirs.return_number().eq(written.return_number.iter().copied()));
        assert!(theirs.point_source_id().eq(written.point_source_id.iter().copied()));
        assert!(theirs.user_data().eq(written.user_data.iter().copied()));
        assert!(theirs.classification().eq(written.classification.iter().copied()));
    }
}

#[test]
fn a_file_written_by_the_las_crate_is_read_here() {
    let folder = tempfile::tempdir().unwrap();
    for (name, format) in [("a.laz", 7), ("b.las", 3)] {
        let path = folder.path().join(name);
        let mut builder = las::Builder::from((1, 4));
        builder.point_format = las::point::Format::new(format).unwrap();
        builder.point_format.is_compressed = name.ends_with("laz");
        let mut writer = las::Writer::from_path(&path, builder.into_header().unwrap()).unwrap();
        for i in 0..60_000_u32 {
            let point = las::Point {
                x: f64::from(i) * 0.25,
                y: f64::from(i % 100),
                z: 3.5,
                gps_time: Some(f64::from(i) * 0.01),
                color: Some(las::Color::new(1, 2, 3)),
                return_number: 1,
                number_of_returns: 2,
                point_source_id: 42,
                intensity: (i % 1_000) as u16,
                ..las::Point::default()
            };
            writer.write_point(point).unwrap();
        }
        writer.close().unwrap();
        let file = LasFile::open(&path).unwrap();
        assert_eq!(file.header().point_count, 60_000);
        let (mut records, mut columns, mut next) = (Vec::new(), Columns::default(), 0_u32);
        for chunk in 0..file.chunk_count() {
            file.read_columns(chunk, &mut records, &mut columns).unwrap();
            for i in 0..columns.len() {
                let x_m = f64::from(columns.x[i]) * file.header().scale[0] + file.header().offset[0];
                assert!((x_m - f64::from(next) * 0.25).abs() < 1e-3);
                assert_eq!(columns.gps_time[i].to_bits(), (f64::from(next) * 0.01).to_bits());
                assert_eq!((columns.point_source_id[i], columns.intensity[i]), (42, (next % 1_000) as u16));
                assert_eq!((columns.return_number[i], columns.number_of_returns[i]), (1, 2));
                next += 1;
            }
        }
        assert_eq!(next, 60_000);
    }
}
