//! The results file: a line of JSON for what was measured on, then one for every record. It grows as the sweep goes on,
//! so a sweep that was stopped continues where it was.

use super::{Record, Result};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{BufRead, BufReader, Seek, SeekFrom, Write};
use std::path::Path;

/// What all records of a file have in common.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// Name of the device.
    pub device: String,
    /// Its driver.
    pub driver: String,
    /// The library's version.
    pub version: String,
}

/// An open results file.
pub struct Store {
    file: File,
    /// What is in it.
    pub records: Vec<Record>,
}

impl Store {
    /// Opens or begins a file. A last line that was cut off in the middle is dropped and measured again.
    ///
    /// # Errors
    /// Where the file cannot be read or written, is no results file, or is of another device.
    pub fn open(path: &Path, header: &Header) -> Result<Self> {
        let said = |error: std::io::Error| format!("{}: {error}", path.display());
        let mut file = File::options().read(true).write(true).create(true).truncate(false).open(path).map_err(said)?;
        let (known, records, whole) = read(&mut file).map_err(|error| format!("{}: {error}", path.display()))?;
        match known {
            Some(known) if known != *header => {
                let (a, b) =
                    (format!("{}, {}", known.device, known.driver), format!("{}, {}", header.device, header.driver));
                return Err(
                    format!("{}: its records are of {a}, not of {b}: choose another file", path.display()).into()
                );
            }
            _ => {}
        }
        file.set_len(whole).map_err(said)?;
        file.seek(SeekFrom::End(0)).map_err(said)?;
        if known.is_none() {
            writeln!(file, "{}", serde_json::to_string(header)?).map_err(said)?;
        }
        Ok(Self { file, records })
    }

    /// Adds a record, in the file at once.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn add(&mut self, record: Record) -> Result<()> {
        // One write, so that a stop leaves a whole line or a part that the next start drops.
        self.file.write_all(format!("{}\n", serde_json::to_string(&record)?).as_bytes())?;
        self.records.push(record);
        Ok(())
    }
}

/// (header, records, bytes of whole lines)
fn read(file: &mut File) -> Result<(Option<Header>, Vec<Record>, u64)> {
    let (mut header, mut records, mut whole) = (None, Vec::new(), 0);
    let mut reader = BufReader::new(file);
    let mut line = String::new();
    while reader.read_line(&mut line)? > 0 {
        if !line.ends_with('\n') {
            break;
        }
        let wrong = |error| format!("line {} is not one of a results file: {error}", records.len() + 1);
        match header {
            None => header = Some(serde_json::from_str(&line).map_err(wrong)?),
            Some(_) => records.push(serde_json::from_str(&line).map_err(wrong)?),
        }
        whole += line.len() as u64;
        line.clear();
    }
    Ok((header, records, whole))
}

#[cfg(test)]
mod tests {
    use super::super::Clock;
    use super::*;

    fn header() -> Header {
        Header { device: "a".into(), driver: "b".into(), version: "1".into() }
    }

    fn record(spp: u32) -> Record {
        let (network, tier, scene, view) = ("n".into(), "t".into(), "s".into(), "v".into());
        let (clock, seconds, seconds_min) = (Clock::Cpu, 2.0, 1.0);
        let (psnr, relmse, flip) = (30.0, 0.1, 0.2);
        let (ssim, nmse, worst) = (Some(0.5), Some(1e-12), None);
        Record {
            network,
            tier,
            scene,
            view,
            spp,
            pixels: 9,
            clock,
            seconds,
            seconds_min,
            runs: 3,
            psnr,
            ssim,
            relmse,
            flip,
            nmse,
            worst,
        }
    }

    #[test]
    fn a_stopped_sweep_goes_on() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r.jsonl");
        let mut store = Store::open(&path, &header()).unwrap();
        store.add(record(1)).unwrap();
        store.add(record(4)).unwrap();
        drop(store);
        // The third line was being written.
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, format!("{text}{{\"network\": \"n")).unwrap();
        let mut store = Store::open(&path, &header()).unwrap();
        assert_eq!(store.records, [record(1), record(4)]);
        store.add(record(32)).unwrap();
        drop(store);
        assert_eq!(Store::open(&path, &header()).unwrap().records, [record(1), record(4), record(32)]);
    }

    #[test]
    fn other_files_are_refused_and_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r.jsonl");
        std::fs::write(&path, "a letter\n").unwrap();
        assert!(Store::open(&path, &header()).err().unwrap().to_string().contains("line 1"));
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "a letter\n");
        std::fs::remove_file(&path).unwrap();
        drop(Store::open(&path, &header()).unwrap());
        let other = Header { device: "c".into(), ..header() };
        let error = Store::open(&path, &other).err().unwrap().to_string();
        assert!(error.contains("choose another file"), "{error}");
    }
}
