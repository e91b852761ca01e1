// vkdenoise in C++17: objects that destroy themselves, errors that are thrown. Needs vkdenoise.h and nothing else.

#ifndef VKDENOISE_HPP
#define VKDENOISE_HPP

#include <vkdenoise.h>

#include <cstdint>
#include <exception>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

namespace vkdenoise {

// What a failed call said.
class Error : public std::runtime_error {
 public:
  explicit Error(vkdenoise_status status) : std::runtime_error(vkdenoise_last_error()), status_(status) {}
  vkdenoise_status status() const noexcept { return status_; }

 private:
  vkdenoise_status status_;
};

// Throws the error of a call that failed.
inline void check(vkdenoise_status status) {
  if (status != VKDENOISE_STATUS_OK) throw Error(status);
}

// A struct of the interface with its size set and all other fields 0.
template <class T>
T make() {
  T value = T();
  value.struct_size = sizeof(T);
  return value;
}

namespace detail {
template <class T, void (*destroy)(T*)>
struct Destroy {
  void operator()(T* object) const noexcept { destroy(object); }
};
// Owns an object of the interface.
template <class T, void (*destroy)(T*)>
using Handle = std::unique_ptr<T, Destroy<T, destroy>>;

// A progress callback, and what it threw: nothing is thrown through the library.
struct Watch {
  const std::function<bool(float)>& progress;
  std::exception_ptr thrown;

  static std::uint32_t call(void* user, float share) noexcept {
    auto& watch = *static_cast<Watch*>(user);
    try {
      return watch.progress(share) ? 1 : 0;
    } catch (...) {
      watch.thrown = std::current_exception();
      return 0;
    }
  }
};
}  // namespace detail

// Every Vulkan device there is, usable or not.
inline std::vector<vkdenoise_device_info> devices() {
  vkdenoise_device_list* made = nullptr;
  check(vkdenoise_device_list_create(&made));
  detail::Handle<vkdenoise_device_list, vkdenoise_device_list_destroy> list(made);
  std::vector<vkdenoise_device_info> infos(vkdenoise_device_list_count(list.get()), make<vkdenoise_device_info>());
  for (std::uint32_t i = 0; i < infos.size(); i++) check(vkdenoise_device_list_get(list.get(), i, &infos[i]));
  return infos;
}

// A device that denoisers run on: of the library's own, or a renderer's.
class Device {
 public:
  explicit Device(const vkdenoise_device_options& options = make<vkdenoise_device_options>()) {
    vkdenoise_device* made = nullptr;
    check(vkdenoise_device_open(&options, &made));
    handle_.reset(made);
  }
  explicit Device(const vkdenoise_renderer& renderer) {
    vkdenoise_device* made = nullptr;
    check(vkdenoise_device_from_renderer(&renderer, &made));
    handle_.reset(made);
  }

  vkdenoise_device_info info() const {
    auto info = make<vkdenoise_device_info>();
    check(vkdenoise_device_get_info(get(), &info));
    return info;
  }
  // Bytes of device memory that the library holds on it.
  std::uint64_t memory_bytes() const noexcept { return vkdenoise_device_memory_bytes(get()); }
  vkdenoise_device* get() const noexcept { return handle_.get(); }

 private:
  detail::Handle<vkdenoise_device, vkdenoise_device_destroy> handle_;
};

// A frame in a renderer's buffers or images, resolved for a pass.
class Binding {
 public:
  vkdenoise_binding* get() const noexcept { return handle_.get(); }

 private:
  friend class Pass;
  explicit Binding(vkdenoise_binding* made) : handle_(made) {}
  detail::Handle<vkdenoise_binding, vkdenoise_binding_destroy> handle_;
};

// The denoiser for one frame size, to be recorded into a renderer's command buffers.
class Pass {
 public:
  Binding bind(const vkdenoise_buffer_frame& frame) const {
    vkdenoise_binding* made = nullptr;
    check(vkdenoise_pass_bind_buffers(get(), &frame, &made));
    return Binding(made);
  }
  Binding bind(const vkdenoise_image_frame& frame) const {
    vkdenoise_binding* made = nullptr;
    check(vkdenoise_pass_bind_images(get(), &frame, &made));
    return Binding(made);
  }
  // See vkdenoise_pass_record for the barriers around it.
  void record(VkCommandBuffer_T* commands, const Binding& binding,
              const vkdenoise_frame_options& options = make<vkdenoise_frame_options>()) const {
    check(vkdenoise_pass_record(get(), commands, binding.get(), &options));
  }
  vkdenoise_pass* get() const noexcept { return handle_.get(); }

 private:
  friend class Denoiser;
  explicit Pass(vkdenoise_pass* made) : handle_(made) {}
  detail::Handle<vkdenoise_pass, vkdenoise_pass_destroy> handle_;
};

// Device memory that passes of several sizes compute in, whichever runs.
class Arena {
 public:
  // Of the blocks that Denoiser::arena_required tells.
  Arena(const Device& device, const std::vector<std::uint64_t>& blocks) {
    vkdenoise_arena* made = nullptr;
    check(vkdenoise_arena_create(device.get(), blocks.data(), blocks.size(), &made));
    handle_.reset(made);
  }
  // In the caller's memory.
  Arena(const Device& device, const std::vector<vkdenoise_arena_block>& blocks) {
    vkdenoise_arena* made = nullptr;
    check(vkdenoise_arena_from_buffers(device.get(), blocks.data(), blocks.size(), &made));
    handle_.reset(made);
  }
  vkdenoise_arena* get() const noexcept { return handle_.get(); }

 private:
  detail::Handle<vkdenoise_arena, vkdenoise_arena_destroy> handle_;
};

// A network on a device.
class Denoiser {
 public:
  explicit Denoiser(const Device& device, const vkdenoise_options& options = make<vkdenoise_options>()) {
    vkdenoise_denoiser* made = nullptr;
    check(vkdenoise_denoiser_create(device.get(), &options, &made));
    handle_.reset(made);
  }

  // Denoises a frame in host memory and waits for the result.
  vkdenoise_report denoise(const vkdenoise_frame& frame,
                           const vkdenoise_frame_options& options = make<vkdenoise_frame_options>()) {
    auto report = make<vkdenoise_report>();
    check(vkdenoise_denoise(get(), &frame, &options, &report));
    return report;
  }
  // The same with a function that is told the share of the work that is done, from 0 to 1. It answers true to go on,
  // false to end the call with an Error of VKDENOISE_STATUS_CANCELLED; what it throws ends the call and is thrown on.
  vkdenoise_report denoise(const vkdenoise_frame& frame, vkdenoise_frame_options options,
                           const std::function<bool(float)>& progress) {
    detail::Watch watch{progress, nullptr};
    options.progress = detail::Watch::call;
    options.progress_user = &watch;
    auto report = make<vkdenoise_report>();
    const vkdenoise_status status = vkdenoise_denoise(get(), &frame, &options, &report);
    if (watch.thrown) std::rethrow_exception(watch.thrown);
    check(status);
    return report;
  }
  vkdenoise_memory memory_required(std::uint32_t width, std::uint32_t height) const {
    auto memory = make<vkdenoise_memory>();
    check(vkdenoise_denoiser_memory_required(get(), width, height, &memory));
    return memory;
  }
  // Prepares a frame size for a renderer.
  Pass pass(std::uint32_t width, std::uint32_t height) const {
    vkdenoise_pass* made = nullptr;
    check(vkdenoise_pass_create(get(), width, height, &made));
    return Pass(made);
  }
  // Bytes of each block of an arena in which passes of all these sizes fit.
  std::vector<std::uint64_t> arena_required(const std::vector<vkdenoise_size>& sizes) const {
    std::size_t count = 0;
    check(vkdenoise_denoiser_arena_required(get(), sizes.data(), sizes.size(), nullptr, &count));
    std::vector<std::uint64_t> blocks(count);
    check(vkdenoise_denoiser_arena_required(get(), sizes.data(), sizes.size(), blocks.data(), &count));
    return blocks;
  }
  // The same in an arena that passes share.
  Pass pass(const Arena& arena, std::uint32_t width, std::uint32_t height) const {
    vkdenoise_pass* made = nullptr;
    check(vkdenoise_pass_create_in(get(), arena.get(), width, height, &made));
    return Pass(made);
  }
  std::uint32_t precision() const noexcept { return vkdenoise_denoiser_precision(get()); }
  vkdenoise_denoiser* get() const noexcept { return handle_.get(); }

 private:
  detail::Handle<vkdenoise_denoiser, vkdenoise_denoiser_destroy> handle_;
};

}  // namespace vkdenoise

#endif  // VKDENOISE_HPP
