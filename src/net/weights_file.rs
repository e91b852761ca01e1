//! A weights file, untrusted: safetensors with the metadata of [`super::Weights::from_bytes`].

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use half::f16;
use safetensors::Dtype;
use safetensors::tensor::{Metadata, TensorInfo};
use serde::de::{DeserializeOwned, IgnoredAny};

use super::arch::Arch;
use super::weights::{Preprocessing, Tensor, WeightsError};

/// The largest file read. The largest network that ships has 127 MB in f32.
const MAX_FILE: u64 = 1 << 30;
/// The largest header read. The largest architecture allowed needs 3 MB.
const MAX_HEADER: usize = 4 << 20;
/// The metadata entry `format`.
const FORMAT: &str = "vkdenoise-1";

/// What a file holds, tensors not yet checked against the network.
pub(super) struct WeightsFile {
    pub arch: Arch,
    pub preprocessing: Preprocessing,
    pub training: String,
    pub tensors: BTreeMap<String, Tensor>,
}

/// The bytes of a regular file, refused unread if it is absurdly large.
pub(super) fn read(path: &Path) -> io::Result<Vec<u8>> {
    let file = File::open(path)?;
    let size = file.metadata()?.len();
    if size > MAX_FILE {
        let message = format!("{size} bytes, more than the {MAX_FILE} of any weights file");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, message));
    }
    let mut bytes = Vec::new();
    // A device has no size but may never end.
    file.take(size).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Takes a file apart.
pub(super) fn parse(bytes: &[u8]) -> Result<WeightsFile, WeightsError> {
    let (header, data) = split(bytes)?;
    let unsound = |e: serde_json::Error| WeightsError::Malformed(shown(&e.to_string()));
    // Checks that the tensors lie back to back from 0 and that their sizes agree with their shapes.
    let header: Metadata = serde_json::from_slice(header).map_err(unsound)?;
    if header.data_len() != data.len() {
        let (promised, there) = (header.data_len(), data.len());
        return Err(WeightsError::Malformed(format!("{there} bytes of tensors where the header says {promised}")));
    }
    let none = HashMap::new();
    let metadata = header.metadata().as_ref().unwrap_or(&none);
    let format = entry(metadata, "format")?;
    if format != FORMAT {
        return Err(bad("format", format!("'{}' is not '{FORMAT}'", shown(format))));
    }
    let training = metadata.get("training").map_or("{}", String::as_str);
    json::<IgnoredAny>("training", training)?;
    let preprocessing: Preprocessing = json("preprocessing", entry(metadata, "preprocessing")?)?;
    if !(1..=Preprocessing::VERSION).contains(&preprocessing.version) {
        let (version, known) = (preprocessing.version, Preprocessing::VERSION);
        return Err(bad(
            "preprocessing",
            format!("version {version}; this library knows 1 to {known}: use a newer one"),
        ));
    }
    Ok(WeightsFile {
        arch: json("architecture", entry(metadata, "architecture")?)?,
        preprocessing,
        training: training.into(),
        tensors: header
            .tensors()
            .into_iter()
            .map(|(name, info)| decode(&name, info, data).map(|tensor| (name, tensor)))
            .collect::<Result<_, _>>()?,
    })
}

/// Text of a file made fit for a message: no control characters, not long.
pub(super) fn shown(text: &str) -> String {
    text.chars().take(200).flat_map(char::escape_debug).collect()
}

/// The JSON header and the tensors' bytes.
fn split(bytes: &[u8]) -> Result<(&[u8], &[u8]), WeightsError> {
    let short = || WeightsError::Malformed(format!("{} bytes do not hold the header they announce", bytes.len()));
    let (size, rest) = bytes.split_first_chunk::<8>().ok_or_else(short)?;
    let size = u64::from_le_bytes(*size);
    match usize::try_from(size) {
        Ok(size) if size <= MAX_HEADER => rest.split_at_checked(size).ok_or_else(short),
        _ => Err(WeightsError::Malformed(format!("a header of {size} bytes, more than {MAX_HEADER}"))),
    }
}

fn bad(key: &'static str, reason: String) -> WeightsError {
    WeightsError::Metadata { key, reason }
}

fn entry<'a>(metadata: &'a HashMap<String, String>, key: &'static str) -> Result<&'a str, WeightsError> {
    metadata.get(key).map(String::as_str).ok_or_else(|| bad(key, "missing".into()))
}

fn json<T: DeserializeOwned>(key: &'static str, text: &str) -> Result<T, WeightsError> {
    serde_json::from_str(text).map_err(|e| bad(key, shown(&e.to_string())))
}

fn decode(name: &str, info: &TensorInfo, data: &[u8]) -> Result<Tensor, WeightsError> {
    let unsound = || WeightsError::Malformed(format!("tensor {} has an impossible extent", shown(name)));
    let (start, end) = info.data_offsets;
    let bytes = data.get(start..end).ok_or_else(unsound)?;
    let shape = info.shape.iter().map(|&n| u32::try_from(n)).collect::<Result<_, _>>().map_err(|_| unsound())?;
    let data = match info.dtype {
        Dtype::F32 => bytes.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect(),
        Dtype::F16 => bytes.as_chunks().0.iter().map(|&b| f16::from_le_bytes(b).to_f32()).collect(),
        other => return Err(WeightsError::Type { name: shown(name), found: format!("{other:?}") }),
    };
    Ok(Tensor { shape, data })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::net::Weights;
    use crate::net::arch::{Block, Convolution};
    use crate::net::graph::Graph;
    use proptest::prelude::*;
    use safetensors::tensor::TensorView;

    /// Two small stages with all kinds of block.
    fn arch() -> Arch {
        let mut arch = Arch::hybrid();
        arch.channels = 8;
        arch.stages.truncate(2);
        arch.stages[1].block = Block::ShJsa { ratio: 0.5 };
        arch.stages[0].block = Block::FilmCnn { conv: Convolution::Separable };
        arch.bottleneck.block = Block::Jsa;
        arch
    }

    /// A tensor of a file being written.
    struct Written {
        dtype: Dtype,
        shape: Vec<usize>,
        bytes: Vec<u8>,
    }

    struct Draft {
        metadata: HashMap<String, String>,
        tensors: BTreeMap<String, Written>,
    }

    /// A sound file, every tensor `1, 2, 3, ...`; those of the bottleneck in f16.
    fn draft() -> Draft {
        let mut tensors = BTreeMap::new();
        for spec in Graph::new(&arch()).unwrap().tensors() {
            let shape: Vec<usize> = spec.shape.iter().map(|&n| n as usize).collect();
            let values = (1..=shape.iter().product()).map(|n: usize| n as f32);
            let (dtype, bytes) = if spec.name.starts_with("bottleneck") {
                (Dtype::F16, values.flat_map(|v| f16::from_f32(v).to_le_bytes()).collect())
            } else {
                (Dtype::F32, values.flat_map(f32::to_le_bytes).collect())
            };
            tensors.insert(spec.name, Written { dtype, shape, bytes });
        }
        let metadata = [
            ("format", FORMAT.to_owned()),
            ("architecture", serde_json::to_string(&arch()).unwrap()),
            ("preprocessing", r#"{"exposure":"auto","depth":"percentile"}"#.into()),
            ("training", r#"{"steps":[1,2]}"#.into()),
        ];
        Draft { metadata: metadata.map(|(k, v)| (k.to_owned(), v)).into(), tensors }
    }

    impl Draft {
        fn bytes(&self) -> Vec<u8> {
            let views = self
                .tensors
                .iter()
                .map(|(name, t)| (name, TensorView::new(t.dtype, t.shape.clone(), &t.bytes).unwrap()));
            safetensors::serialize(views, Some(self.metadata.clone())).unwrap()
        }

        fn tensor(&mut self, name: &str) -> &mut Written {
            self.tensors.get_mut(name).unwrap()
        }
    }

    #[test]
    fn a_sound_file_is_read() {
        let mut draft = draft();
        // As PyTorch saves a 1x1 convolution.
        draft.tensor("aux_proj.out.weight").shape.extend([1, 1]);
        let weights = Weights::from_bytes(&draft.bytes()).unwrap();
        assert_eq!(weights.arch(), &arch());
        assert_eq!(weights.preprocessing().version, 1);
        assert_eq!(weights.training(), r#"{"steps":[1,2]}"#);
        for (name, shape) in [("aux_proj.out.weight", [8, 24]), ("bottleneck.0.q.weight", [32, 32])] {
            let tensor = weights.tensor(name).unwrap();
            assert_eq!((&tensor.shape[..], tensor.data[16]), (&shape[..], 17.0), "{name}");
        }
        assert!(weights.tensor("bottleneck").is_err());
    }

    #[test]
    fn a_file_on_disk_is_read_and_a_device_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("weights.safetensors");
        std::fs::write(&path, draft().bytes()).unwrap();
        assert!(Weights::from_file(&path).is_ok());
        assert!(Weights::from_file("/dev/zero").is_err());
        let missing = Weights::from_file(folder.path().join("none")).unwrap_err().to_string();
        assert!(missing.contains("none"), "{missing}");
    }

    #[test]
    fn what_does_not_fit_the_network_is_refused_with_its_reason() {
        type Spoil = Box<dyn Fn(&mut Draft)>;
        let set = |key: &'static str, value: &str| -> Spoil {
            let value = value.to_owned();
            Box::new(move |d| drop(d.metadata.insert(key.into(), value.clone())))
        };
        let deep = "[".repeat(1000);
        let cases: Vec<(&str, Spoil)> = vec![
            ("'format': missing", Box::new(|d| d.metadata.clear())),
            ("'architecture': missing", Box::new(|d| drop(d.metadata.remove("architecture")))),
            ("'format'", set("format", "vkdenoise-2\u{1b}")),
            ("'architecture'", set("architecture", "{}")),
            ("'preprocessing'", set("preprocessing", r#"{"exposure":"auto","depth":"max"}"#)),
            ("knows 1 to 2", set("preprocessing", r#"{"exposure":"auto","depth":"percentile","version":3}"#)),
            ("'training'", set("training", &deep)),
            ("patch", set("architecture", &serde_json::to_string(&Arch { patch: 4, ..arch() }).unwrap())),
            ("lack the tensor output.bias", Box::new(|d| drop(d.tensors.remove("output.bias")))),
            (
                "tensor ghost",
                Box::new(|d| {
                    d.tensors.insert("ghost".into(), Written { dtype: Dtype::F32, shape: vec![0], bytes: vec![] });
                }),
            ),
            ("output.weight has shape [8, 3, 3, 3]", Box::new(|d| d.tensor("output.weight").shape.swap(0, 1))),
            ("BF16", Box::new(|d| d.tensor("bottleneck.1.q.bias").dtype = Dtype::BF16)),
            (
                "holds NaN at element 1",
                Box::new(|d| {
                    d.tensor("output.bias").bytes[4..8].copy_from_slice(&f32::NAN.to_le_bytes());
                }),
            ),
            (
                "holds inf at element 0",
                Box::new(|d| {
                    d.tensor("bottleneck.0.q.bias").bytes[..2].copy_from_slice(&f16::INFINITY.to_le_bytes());
                }),
            ),
        ];
        for (words, spoil) in cases {
            let mut draft = draft();
            spoil(&mut draft);
            let message = Weights::from_bytes(&draft.bytes()).unwrap_err().to_string();
            assert!(message.contains(words), "'{message}' does not say '{words}'");
            assert!(!message.contains('\u{1b}'), "{message:?}");
        }
    }

    #[test]
    fn a_damaged_container_is_refused() {
        let sound = draft().bytes();
        let with_header = |header: &str| [&(header.len() as u64).to_le_bytes(), header.as_bytes()].concat();
        let absurd = r#"{"a":{"dtype":"F32","shape":[4294967296,4294967296],"data_offsets":[0,16]}}"#;
        let far = r#"{"a":{"dtype":"U8","shape":[18446744073709551615],"data_offsets":[0,18446744073709551615]}}"#;
        let cases = [
            Vec::new(),
            sound[..7].to_vec(),
            sound[..100].to_vec(),
            sound[..sound.len() - 1].to_vec(),
            [&sound[..], &[0]].concat(),
            [&u64::MAX.to_le_bytes(), &sound[8..]].concat(),
            [&(1u64 << 30).to_le_bytes(), &sound[8..]].concat(),
            with_header("{"),
            with_header("{}"),
            with_header(&"[".repeat(100_000)),
            with_header(absurd),
            with_header(far),
        ];
        for (i, bytes) in cases.iter().enumerate() {
            assert!(Weights::from_bytes(bytes).is_err(), "case {i}");
        }
    }

    proptest! {
        #[test]
        fn no_damage_panics(at in 0.0..1.0f64, in_header: bool, byte: u8, cut: bool) {
            let mut bytes = draft().bytes();
            let header = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
            let i = (at * if in_header { header } else { bytes.len() } as f64) as usize;
            bytes[i] = byte;
            if cut {
                bytes.truncate(i);
            }
            let _ = Weights::from_bytes(&bytes);
        }
    }
}
