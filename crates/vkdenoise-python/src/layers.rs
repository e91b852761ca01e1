//! Arrays beside a frame that go through the kernels of its colour: parts of its light, and other layers.

use crate::arrays::Input;
use crate::output::Output;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};
use vkdenoise::{Region, Signal, SignalKind};

/// One of them, and the new array of its result.
struct Layer<'py> {
    name: String,
    kind: SignalKind,
    input: Input<'py>,
    output: Output<'py>,
}

/// Those of a call.
#[derive(Default)]
pub struct Layers<'py> {
    layers: Vec<Layer<'py>>,
    /// Whether the caller named any, be it none.
    given: bool,
}

impl<'py> Layers<'py> {
    /// Of the call's dicts, beside a colour.
    ///
    /// # Errors
    /// Where they are no mappings of names to arrays of the colour's size, or have a name twice.
    pub fn new(
        light_groups: Option<&Bound<'py, PyAny>>,
        aovs: Option<&Bound<'py, PyAny>>,
        color: &Input<'py>,
        region: Option<Region>,
    ) -> PyResult<Self> {
        let mut found = Self { layers: Vec::new(), given: light_groups.is_some() || aovs.is_some() };
        let dicts = [("light_groups", SignalKind::Light, light_groups), ("aovs", SignalKind::Value, aovs)];
        for (argument, kind, dict) in dicts {
            let Some(dict) = dict else { continue };
            let Ok(dict) = dict.cast::<PyMapping>() else {
                let found = dict.get_type().name()?;
                return Err(PyTypeError::new_err(format!(
                    "{argument} is a {found}; a dict of names and arrays is wanted"
                )));
            };
            for item in dict.items()?.iter() {
                let (name, array): (Bound<'py, PyAny>, Bound<'py, PyAny>) = item.extract()?;
                let Ok(name) = name.extract::<String>() else {
                    return Err(PyTypeError::new_err(format!(
                        "{argument} has the key {}; a str is wanted",
                        name.repr()?
                    )));
                };
                found.add(argument, kind, name, &array, color, region)?;
            }
        }
        Ok(found)
    }

    fn add(
        &mut self,
        argument: &str,
        kind: SignalKind,
        name: String,
        array: &Bound<'py, PyAny>,
        color: &Input<'py>,
        region: Option<Region>,
    ) -> PyResult<()> {
        if self.layers.iter().any(|layer| layer.name == name) {
            let message = format!("{name:?} is in both light_groups and aovs; their results share one dict");
            return Err(PyValueError::new_err(message));
        }
        let place = format!("{argument}[{name:?}]");
        let input = match kind {
            SignalKind::Light => Input::vectors(&place, array, color)?,
            _ => Input::layer(&place, array, color)?,
        };
        let output = Output::new(&input, region)?;
        self.layers.push(Layer { name, kind, input, output });
        Ok(())
    }

    pub fn is_empty(&self) -> bool {
        self.layers.is_empty()
    }

    /// What is read.
    pub fn inputs(&self) -> impl Iterator<Item = &Input<'py>> {
        self.layers.iter().map(|layer| &layer.input)
    }

    /// As the library takes them.
    pub fn signals(&mut self) -> Vec<Signal<'_>> {
        let layers = self.layers.iter_mut();
        layers
            .map(|Layer { kind, input, output, .. }| {
                let (kind, channels) = (*kind, input.channels() as u32);
                Signal { kind, channels, plane: input.plane(), output: output.plane() }
            })
            .collect()
    }

    /// What the caller gets: the denoised colour, and with it a dict of the others by their names where any were asked
    /// for.
    pub fn finish(self, color: Bound<'py, PyAny>, part: Region) -> PyResult<Bound<'py, PyAny>> {
        if !self.given {
            return Ok(color);
        }
        let py = color.py();
        let results = PyDict::new(py);
        for layer in self.layers {
            results.set_item(layer.name, layer.output.finish(part)?)?;
        }
        Ok((color, results).into_pyobject(py)?.into_any())
    }
}
