//! Whatever numpy can view, as planes of the library.

use half::f16;
use numpy::{PyArrayDyn, PyArrayMethods, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use vkdenoise::{Extent, Layout, Plane};

/// An array of 32- or 16-bit floats.
pub enum Floats<'py> {
    F32(Bound<'py, PyArrayDyn<f32>>),
    F16(Bound<'py, PyArrayDyn<f16>>),
}

/// Where an array's samples lie, from its first one on.
#[derive(Clone, Copy)]
pub struct Span {
    pub layout: Layout,
    /// As many as there are from the first to the last, with what lies between.
    pub samples: usize,
}

impl<'py> Floats<'py> {
    /// An argument as an array: one already, or what has DLPack, the buffer protocol or numpy's own ways to be one.
    pub fn view(name: &str, object: &Bound<'py, PyAny>) -> PyResult<Self> {
        let array = if object.is_instance_of::<PyUntypedArray>() {
            object.clone()
        } else if object.hasattr("__dlpack__")? && object.hasattr("__dlpack_device__")? {
            from_dlpack(name, object)?
        } else {
            object.py().import("numpy")?.call_method1("asarray", (object,))?
        };
        Self::typed(array).map_err(|array| wrong_type(name, &array))
    }

    /// An argument as an array that can be written.
    pub fn view_to_write(name: &str, object: &Bound<'py, PyAny>) -> PyResult<Self> {
        let array = Self::view(name, object)?;
        if array.is_writable()? {
            return Ok(array);
        }
        // Whoever has an older DLPack cannot say that it may be written to; numpy's own way may.
        if object.hasattr("__array__")? {
            let other = object.py().import("numpy")?.call_method1("asarray", (object,))?;
            if let Ok(other) = Self::typed(other)
                && other.address() == array.address()
                && other.is_writable()?
            {
                return Ok(other);
            }
        }
        Err(PyValueError::new_err(format!("{name} is read-only; give an array that can be written, or none")))
    }

    fn is_writable(&self) -> PyResult<bool> {
        self.untyped().as_any().getattr("flags")?.getattr("writeable")?.extract()
    }

    fn typed(array: Bound<'py, PyAny>) -> Result<Self, Bound<'py, PyAny>> {
        let array = match array.cast_into() {
            Ok(floats) => return Ok(Self::F32(floats)),
            Err(other) => other.into_inner(),
        };
        array.cast_into().map(Self::F16).map_err(|other| other.into_inner())
    }

    /// Without its sample type.
    pub fn untyped(&self) -> &Bound<'py, PyUntypedArray> {
        match self {
            Self::F32(array) => array.as_untyped(),
            Self::F16(array) => array.as_untyped(),
        }
    }

    pub fn shape(&self) -> &[usize] {
        self.untyped().shape()
    }

    fn sample_bytes(&self) -> usize {
        match self {
            Self::F32(_) => size_of::<f32>(),
            Self::F16(_) => size_of::<f16>(),
        }
    }

    fn address(&self) -> usize {
        match self {
            Self::F32(array) => array.data() as usize,
            Self::F16(array) => array.data() as usize,
        }
    }

    /// Where the samples of rows, pixels and channels lie; `None` where that is not a whole number of samples from the
    /// first one forward.
    pub fn span(&self) -> Option<Span> {
        let bytes = self.sample_bytes();
        if !self.address().is_multiple_of(bytes) {
            return None;
        }
        let (mut strides, mut last) = ([0; 3], 0);
        for (to, (&size, &stride)) in strides.iter_mut().zip(self.shape().iter().zip(self.untyped().strides())) {
            // Along an axis of one there is no next, and numpy may say anything of it.
            if size > 1 {
                let stride = usize::try_from(stride).ok().filter(|stride| stride.is_multiple_of(bytes))?;
                *to = stride / bytes;
                last += (size - 1) * *to;
            }
        }
        let [row_stride, pixel_stride, channel_stride] = strides;
        Some(Span { layout: Layout { offset: 0, pixel_stride, row_stride, channel_stride }, samples: last + 1 })
    }

    /// Another array of the same samples, dense and its own.
    pub fn copied(&self) -> PyResult<Self> {
        let numpy = self.untyped().py().import("numpy")?;
        let copy = numpy.call_method1("array", (self.untyped(),))?;
        let dense = numpy.call_method1("ascontiguousarray", (copy,))?;
        Self::typed(dense).map_err(|array| wrong_type("the copy", &array))
    }

    /// A dense array of the same shape and sample type, all 0.
    pub fn dense(&self) -> PyResult<Self> {
        let array = self.untyped();
        let shape = PyTuple::new(array.py(), array.shape())?;
        let zeros = array.py().import("numpy")?.call_method1("zeros", (shape, array.dtype()))?;
        Self::typed(zeros).map_err(|array| wrong_type("the new array", &array))
    }

    /// Addresses of what a span covers.
    pub fn addresses(&self, span: &Span) -> std::ops::Range<usize> {
        self.address()..self.address() + span.samples * self.sample_bytes()
    }
}

/// An array that is read.
pub struct Input<'py> {
    array: Floats<'py>,
    span: Span,
}

impl<'py> Input<'py> {
    /// The colour: height x width x 3, or x 4 with alpha.
    pub fn color(object: &Bound<'py, PyAny>) -> PyResult<Self> {
        let array = Floats::view("color", object)?;
        match array.shape() {
            [height, width, 3 | 4] if *height > 0 && *width > 0 => Self::of(array),
            shape => {
                let hint = match shape {
                    [3 | 4, _, _] => "; numpy.moveaxis(color, 0, -1) brings its channels last",
                    _ => "",
                };
                let wanted = "(height, width, 3) is wanted, or (height, width, 4) with alpha, of at least one pixel";
                Err(PyValueError::new_err(format!("color has shape {}; {wanted}{hint}", tuple(shape))))
            }
        }
    }

    /// A plane of three channels beside a colour.
    pub fn vectors(name: &str, object: &Bound<'py, PyAny>, color: &Self) -> PyResult<Self> {
        let array = Floats::view(name, object)?;
        let [height, width] = color.size();
        match array.shape() {
            [rows, columns, 3] if [*rows, *columns] == [height, width] => Self::of(array),
            shape => {
                let hint = match shape {
                    [_, _, channels] if *channels > 3 => {
                        format!("; {name}[..., :3] has the first three of its channels")
                    }
                    _ => String::new(),
                };
                Err(PyValueError::new_err(format!(
                    "{name} has shape {}; ({height}, {width}, 3) is wanted, as color has {height} rows of {width} \
                     pixels{hint}",
                    tuple(shape)
                )))
            }
        }
    }

    /// A plane of one channel beside a colour.
    pub fn scalars(name: &str, object: &Bound<'py, PyAny>, color: &Self) -> PyResult<Self> {
        let array = Floats::view(name, object)?;
        let [height, width] = color.size();
        match array.shape() {
            [rows, columns] | [rows, columns, 1] if [*rows, *columns] == [height, width] => Self::of(array),
            shape => Err(PyValueError::new_err(format!(
                "{name} has shape {}; ({height}, {width}) is wanted, or ({height}, {width}, 1), as color has {height} \
                 rows of {width} pixels",
                tuple(shape)
            ))),
        }
    }

    /// A plane of one channel or three beside a colour.
    pub fn layer(name: &str, object: &Bound<'py, PyAny>, color: &Self) -> PyResult<Self> {
        let array = Floats::view(name, object)?;
        let [height, width] = color.size();
        match array.shape() {
            [rows, columns] | [rows, columns, 1 | 3] if [*rows, *columns] == [height, width] => Self::of(array),
            shape => Err(PyValueError::new_err(format!(
                "{name} has shape {}; ({height}, {width}) is wanted, or ({height}, {width}, 1 or 3), as color has \
                 {height} rows of {width} pixels",
                tuple(shape)
            ))),
        }
    }

    fn of(array: Floats<'py>) -> PyResult<Self> {
        match array.span() {
            Some(span) => Ok(Self { array, span }),
            None => {
                let array = array.copied()?;
                let span =
                    array.span().ok_or_else(|| PyValueError::new_err("numpy's copy of an array is not dense"))?;
                Ok(Self { array, span })
            }
        }
    }

    /// Rows and columns.
    fn size(&self) -> [usize; 2] {
        [self.array.shape()[0], self.array.shape()[1]]
    }

    pub fn array(&self) -> &Floats<'py> {
        &self.array
    }

    /// Whether the colour has alpha.
    pub fn has_alpha(&self) -> bool {
        self.channels() == 4
    }

    /// Samples of a pixel.
    pub fn channels(&self) -> usize {
        self.array.shape().get(2).copied().unwrap_or(1)
    }

    /// The frame's size.
    pub fn extent(&self) -> PyResult<Extent> {
        let [height, width] = self.size();
        match (u32::try_from(width), u32::try_from(height)) {
            (Ok(width), Ok(height)) => Ok(Extent::new(width, height)),
            _ => Err(PyValueError::new_err(format!("color has {height} rows of {width} pixels: that is too large"))),
        }
    }

    /// Whether it shares memory with what lies at these addresses.
    pub fn overlaps(&self, other: &std::ops::Range<usize>) -> bool {
        let own = self.array.addresses(&self.span);
        own.start < other.end && other.start < own.end
    }

    /// The samples as the library takes them.
    pub fn plane(&self) -> Plane<'_> {
        let Span { layout, samples } = self.span;
        // SAFETY, of both: numpy owns so many samples from the first one on, in line, as `Floats::span` has found;
        // `self` keeps the array. That nobody writes to it or resizes it meanwhile is the caller's part, as documented.
        match &self.array {
            Floats::F32(array) => Plane::f32(unsafe { std::slice::from_raw_parts(array.data(), samples) }, layout),
            Floats::F16(array) => Plane::f16(unsafe { std::slice::from_raw_parts(array.data(), samples) }, layout),
        }
    }
}

/// DLPack's numbers of what numpy can reach: the CPU, and memory of the host that a GPU can reach too.
const HOST_DEVICES: [i64; 4] = [1, 3, 11, 13];

fn from_dlpack<'py>(name: &str, object: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let (device, _): (i64, i64) = object.call_method0("__dlpack_device__")?.extract()?;
    if !HOST_DEVICES.contains(&device) {
        return Err(PyValueError::new_err(format!(
            "{name} is not in the CPU's memory (DLPack device type {device}); copy it there first, as {name}.cpu() \
             does in torch"
        )));
    }
    let py = object.py();
    py.import("numpy")?.call_method1("from_dlpack", (object,)).map_err(|cause| {
        let error = PyTypeError::new_err(format!("numpy cannot view {name}: {}", cause.value(py)));
        error.set_cause(py, Some(cause));
        error
    })
}

fn wrong_type(name: &str, array: &Bound<'_, PyAny>) -> PyErr {
    let found = array.getattr("dtype").map_or_else(|_| "no dtype".into(), |dtype| format!("dtype {dtype}"));
    let wanted = format!("float32 or float16 is wanted, as {name}.astype(numpy.float32) makes it");
    PyTypeError::new_err(format!("{name} has {found}; {wanted}"))
}

/// A shape as Python writes it.
pub fn tuple(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        _ => format!("({})", shape.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")),
    }
}
