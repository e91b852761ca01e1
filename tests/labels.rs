//! Names of objects and labels in command buffers, as a graphics debugger sees them: a loader between the library and
//! the driver takes them down.

mod common;

use std::ffi::{CStr, c_char, c_void};
use std::mem;
use std::sync::{Mutex, OnceLock, PoisonError};
use vkdenoise::ash::{ext, vk};
use vkdenoise::{
    Binding, BufferFrame, BufferPlane, Cache, Denoiser, Device, EnabledFeatures, Error, Extent, FrameOptions, Layout,
    Options, Pass, RendererDevice, SampleFormat, Weights,
};

use common::vulkan::Renderer;

const EXTENT: Extent = Extent::new(24, 17);

/// The renderer's own functions, and what was called of those that are watched.
struct Real {
    instance: vk::PFN_vkGetInstanceProcAddr,
    device: vk::PFN_vkGetDeviceProcAddr,
    debug: ext::debug_utils::Device,
}

static REAL: OnceLock<Real> = OnceLock::new();
static CALLS: Mutex<Vec<String>> = Mutex::new(Vec::new());

fn real() -> &'static Real {
    REAL.get().expect("the renderer is there")
}

fn called(call: String) {
    CALLS.lock().unwrap_or_else(PoisonError::into_inner).push(call);
}

fn take_calls() -> Vec<String> {
    mem::take(&mut *CALLS.lock().unwrap_or_else(PoisonError::into_inner))
}

unsafe extern "system" fn instance_proc(instance: vk::Instance, name: *const c_char) -> vk::PFN_vkVoidFunction {
    // SAFETY: the arguments are the library's.
    unsafe {
        if CStr::from_ptr(name) == c"vkGetDeviceProcAddr" {
            return Some(mem::transmute::<vk::PFN_vkGetDeviceProcAddr, unsafe extern "system" fn()>(device_proc));
        }
        (real().instance)(instance, name)
    }
}

unsafe extern "system" fn device_proc(device: vk::Device, name: *const c_char) -> vk::PFN_vkVoidFunction {
    type Function = unsafe extern "system" fn();
    // SAFETY: as above.
    unsafe {
        match CStr::from_ptr(name).to_bytes() {
            b"vkSetDebugUtilsObjectNameEXT" => {
                Some(mem::transmute::<vk::PFN_vkSetDebugUtilsObjectNameEXT, Function>(set_name))
            }
            b"vkCmdBeginDebugUtilsLabelEXT" => {
                Some(mem::transmute::<vk::PFN_vkCmdBeginDebugUtilsLabelEXT, Function>(begin))
            }
            b"vkCmdEndDebugUtilsLabelEXT" => Some(mem::transmute::<vk::PFN_vkCmdEndDebugUtilsLabelEXT, Function>(end)),
            _ => (real().device)(device, name),
        }
    }
}

unsafe extern "system" fn set_name(device: vk::Device, info: *const vk::DebugUtilsObjectNameInfoEXT<'_>) -> vk::Result {
    // SAFETY: as above.
    unsafe {
        let name = (*info).object_name_as_c_str().unwrap().to_string_lossy().into_owned();
        called(format!("{:?} {name}", (*info).object_type));
        (real().debug.fp().set_debug_utils_object_name_ext)(device, info)
    }
}

unsafe extern "system" fn begin(commands: vk::CommandBuffer, info: *const vk::DebugUtilsLabelEXT<'_>) {
    // SAFETY: as above.
    unsafe {
        called((*info).label_name_as_c_str().unwrap().to_string_lossy().into_owned());
        (real().debug.fp().cmd_begin_debug_utils_label_ext)(commands, info);
    }
}

unsafe extern "system" fn end(commands: vk::CommandBuffer) {
    called("end".into());
    // SAFETY: as above.
    unsafe { (real().debug.fp().cmd_end_debug_utils_label_ext)(commands) };
}

/// The renderer's device through the loader above.
fn watched(renderer: &Renderer, debug_utils: bool) -> Result<Device, Error> {
    let mut raw = renderer.raw();
    REAL.get_or_init(|| Real {
        // SAFETY: that is what the pointer is.
        instance: unsafe { mem::transmute::<*const c_void, vk::PFN_vkGetInstanceProcAddr>(raw.get_instance_proc_addr) },
        device: renderer.instance.fp_v1_0().get_device_proc_addr,
        debug: ext::debug_utils::Device::new(&renderer.instance, &renderer.device),
    });
    let enabled = EnabledFeatures { debug_utils, ..raw.enabled };
    (raw.get_instance_proc_addr, raw.enabled) = (instance_proc as *const c_void, enabled);
    // SAFETY: the handles are the renderer's, which lives to the end of the test.
    unsafe {
        let mut handles = RendererDevice::from_raw(&raw)?;
        handles.cache = Cache::Off;
        Device::from_renderer(handles)
    }
}

fn bound(renderer: &Renderer, denoiser: &Denoiser) -> (Pass, Binding) {
    let pass = denoiser.pass(EXTENT).unwrap();
    let buffer = renderer.buffer(12 * EXTENT.pixels());
    let (size, layout) = (buffer.size, Layout::interleaved(EXTENT, 3));
    let plane = BufferPlane { buffer: buffer.raw, size, format: SampleFormat::F32, layout };
    // SAFETY: the buffer is never destroyed.
    let binding = unsafe { pass.bind_buffers(&BufferFrame::new(plane, plane)) }.unwrap();
    (pass, binding)
}

#[test]
fn a_debugger_sees_names_and_labels() {
    let renderer = Renderer::new();
    let weights = Weights::hybrid_kernels().unwrap();
    let label = format!("vkdenoise {} 24x17", weights.arch().name);
    for label_kernels in [false, true] {
        let device = watched(&renderer, true).unwrap();
        let options = Options { label_kernels, ..Options::default() };
        let denoiser = Denoiser::new(&device, &weights, &options).unwrap();
        let (pass, binding) = bound(&renderer, &denoiser);
        let named = take_calls();
        for name in ["BUFFER vkdenoise: packed weights", "BUFFER vkdenoise: arena 0"] {
            assert!(named.iter().any(|call| call == name), "{name}: {named:#?}");
        }
        assert!(named.iter().any(|call| call.starts_with("PIPELINE vkdenoise: conv3x3")), "{named:#?}");
        assert!(named.iter().all(|call| call.contains("vkdenoise: ")), "{named:#?}");

        let profiler = renderer.host_query_reset.then(|| pass.profiler(1).unwrap());
        renderer.wait(renderer.submit(|commands| {
            // SAFETY: everything lives until the fence is waited for.
            unsafe {
                match &profiler {
                    Some(profiler) => {
                        pass.record_profiled(commands, &binding, &FrameOptions::default(), profiler, 0).unwrap()
                    }
                    None => pass.record(commands, &binding, &FrameOptions::default()).unwrap(),
                }
            }
        }));
        let calls = take_calls();
        assert_eq!((&calls[0], calls.last().unwrap()), (&label, &"end".to_owned()));
        let kernels = &calls[1..calls.len() - 1];
        if !label_kernels {
            assert!(kernels.is_empty(), "{kernels:#?}");
        } else if let Some(profiler) = profiler {
            // By the profiler's names, one after another.
            let records = profiler.read(0).unwrap().unwrap();
            let ran = records.iter().filter(|record| !record.skipped);
            let expected: Vec<_> =
                ran.flat_map(|record| [format!("{} ({})", record.name, record.variant), "end".into()]).collect();
            assert_eq!(kernels, expected);
            assert!(kernels.len() > 100);
        }
    }

    // A renderer without the extension is not asked for it.
    let device = watched(&renderer, false).unwrap();
    let options = Options { label_kernels: true, ..Options::default() };
    let denoiser = Denoiser::new(&device, &weights, &options).unwrap();
    let (pass, binding) = bound(&renderer, &denoiser);
    renderer.record_only(|commands| {
        // SAFETY: nothing of it is submitted.
        unsafe { pass.record(commands, &binding, &FrameOptions::default()) }.unwrap();
    });
    assert_eq!(take_calls(), [""; 0]);
    drop((binding, pass, denoiser, device));
    renderer.assert_silent();
}

/// A loader that does not know the extension.
#[test]
fn what_is_not_there_is_refused() {
    unsafe extern "system" fn instance_without(instance: vk::Instance, name: *const c_char) -> vk::PFN_vkVoidFunction {
        // SAFETY: the arguments are the library's; the same below.
        unsafe {
            if CStr::from_ptr(name) == c"vkGetDeviceProcAddr" {
                return Some(mem::transmute::<vk::PFN_vkGetDeviceProcAddr, unsafe extern "system" fn()>(
                    device_without,
                ));
            }
            (real().instance)(instance, name)
        }
    }
    unsafe extern "system" fn device_without(device: vk::Device, name: *const c_char) -> vk::PFN_vkVoidFunction {
        // SAFETY: as above.
        unsafe {
            let hidden = CStr::from_ptr(name) == c"vkCmdEndDebugUtilsLabelEXT";
            if hidden { None } else { (real().device)(device, name) }
        }
    }
    let renderer = Renderer::new();
    watched(&renderer, false).unwrap();
    let mut raw = renderer.raw();
    raw.get_instance_proc_addr = instance_without as *const c_void;
    // SAFETY: the handles are the renderer's, which lives to the end of the test.
    let refused = unsafe { RendererDevice::from_raw(&raw).and_then(|handles| Device::from_renderer(handles)) };
    assert!(matches!(refused, Err(Error::InvalidOption { option: "debug_utils", .. })), "{refused:?}");
    renderer.assert_silent();
}
