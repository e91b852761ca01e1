//! What the driver's compiler says of a pipeline: registers, spills, shared memory, instructions
//! (`VK_KHR_pipeline_executable_properties`).

use super::Checked;
use super::device::Device;
use super::pipeline::Pipeline;
use crate::error::Result;
use ash::vk;
use std::ffi::CStr;
use std::fmt;

/// One figure of a kernel, in the driver's own words.
#[derive(Clone, Debug, PartialEq)]
pub struct PipelineStatistic {
    /// The kernel variant, with what its pipeline is specialised for: `linear+residual`.
    pub variant: String,
    /// The part of it that the figure is of; a compute kernel mostly has one.
    pub executable: String,
    /// What is counted.
    pub name: String,
    /// How many.
    pub value: StatisticValue,
}

/// A figure in the type that the driver gives it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StatisticValue {
    /// Yes or no.
    Bool(bool),
    /// A signed count.
    I64(i64),
    /// A count.
    U64(u64),
    /// A ratio or a size.
    F64(f64),
}

impl fmt::Display for StatisticValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bool(value) => value.fmt(f),
            Self::I64(value) => value.fmt(f),
            Self::U64(value) => value.fmt(f),
            Self::F64(value) => value.fmt(f),
        }
    }
}

/// The statistics of a pipeline; none where the device has none to give.
pub(crate) fn of_pipeline(device: &Device, variant: &str, pipeline: &Pipeline) -> Result<Vec<PipelineStatistic>> {
    let Some(loader) = device.executables() else { return Ok(Vec::new()) };
    let info = vk::PipelineInfoKHR::default().pipeline(pipeline.raw);
    // SAFETY: the pipeline is alive and of the loader's device.
    let executables = unsafe { loader.get_pipeline_executable_properties(&info) };
    let executables = executables.called("vkGetPipelineExecutablePropertiesKHR")?;
    let mut found = Vec::new();
    for (index, executable) in (0..).zip(&executables) {
        let info = vk::PipelineExecutableInfoKHR::default().pipeline(pipeline.raw).executable_index(index);
        // SAFETY: as above; the index is one of those just counted, and the pipeline captures statistics.
        let statistics = unsafe { loader.get_pipeline_executable_statistics(&info) };
        for statistic in statistics.called("vkGetPipelineExecutableStatisticsKHR")? {
            found.push(PipelineStatistic {
                variant: variant.to_owned(),
                executable: text(executable.name_as_c_str()),
                name: text(statistic.name_as_c_str()),
                value: value(&statistic),
            });
        }
    }
    Ok(found)
}

fn text<E>(name: Result<&CStr, E>) -> String {
    name.map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

fn value(statistic: &vk::PipelineExecutableStatisticKHR) -> StatisticValue {
    // SAFETY: the format says which member of the union the driver wrote.
    unsafe {
        match statistic.format {
            vk::PipelineExecutableStatisticFormatKHR::BOOL32 => StatisticValue::Bool(statistic.value.b32 != 0),
            vk::PipelineExecutableStatisticFormatKHR::INT64 => StatisticValue::I64(statistic.value.i64),
            vk::PipelineExecutableStatisticFormatKHR::FLOAT64 => StatisticValue::F64(statistic.value.f64),
            _ => StatisticValue::U64(statistic.value.u64),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_format_picks_the_value() {
        let of =
            |format, value| self::value(&vk::PipelineExecutableStatisticKHR { format, value, ..Default::default() });
        type Format = vk::PipelineExecutableStatisticFormatKHR;
        type Value = vk::PipelineExecutableStatisticValueKHR;
        assert_eq!(of(Format::UINT64, Value { u64: 96 }), StatisticValue::U64(96));
        assert_eq!(of(Format::INT64, Value { i64: -1 }), StatisticValue::I64(-1));
        assert_eq!(of(Format::FLOAT64, Value { f64: 0.5 }), StatisticValue::F64(0.5));
        assert_eq!(of(Format::BOOL32, Value { b32: 1 }), StatisticValue::Bool(true));
    }
}
