// Memory and timeline semaphores by file descriptors: a pass on the library's own queue between two values of a
// semaphore, its planes in shared buffers that another Vulkan device in this process fills and reads. The result is
// that of the host path. What a driver cannot share is refused, and said to be not run.

#include <time.h>
#include <unistd.h>

#include "../../examples/own_vulkan.h"

enum { WIDTH = 48, HEIGHT = 40, SAMPLES = 3 * WIDTH * HEIGHT, BYTES = SAMPLES * sizeof(float) };
static const uint64_t LONG = 600000000000u;

static int failures;

#define EXPECT(condition)                                                                            \
  do {                                                                                               \
    if (!(condition)) {                                                                              \
      fprintf(stderr, "%s:%d: %s does not hold; last error: %s\n", __FILE__, __LINE__, #condition,   \
              vkdenoise_last_error());                                                               \
      failures++;                                                                                    \
    }                                                                                                \
  } while (0)

#define REFUSED(call, wanted, words)                                                                 \
  do {                                                                                               \
    vkdenoise_status status_ = (call);                                                               \
    EXPECT(status_ == (wanted));                                                                     \
    EXPECT(strstr(vkdenoise_last_error(), words));                                                   \
  } while (0)

// The other device's side of a shared buffer.
static struct own_buffer theirs_make(struct own_vulkan *own, const vkdenoise_shared_buffer *ours) {
  struct own_buffer made = {.size = BYTES};
  vkdenoise_shared_memory memory = VKDENOISE_INIT(vkdenoise_shared_memory);
  DENOISE(vkdenoise_shared_buffer_export(ours, &memory));
  EXPECT(memory.bytes >= BYTES && memory.handle == VKDENOISE_MEMORY_HANDLE_OPAQUE_FD);
  VkExternalMemoryBufferCreateInfo external = {.sType = VK_STRUCTURE_TYPE_EXTERNAL_MEMORY_BUFFER_CREATE_INFO,
                                               .handleTypes = VK_EXTERNAL_MEMORY_HANDLE_TYPE_OPAQUE_FD_BIT};
  VkBufferCreateInfo buffer = {.sType = VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO,
                               .pNext = &external,
                               .size = BYTES,
                               .usage = VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT};
  VK(vkCreateBuffer(own->device, &buffer, NULL, &made.buffer));
  VkMemoryRequirements needs; // asked for, as validation wants it; the memory is there
  vkGetBufferMemoryRequirements(own->device, made.buffer, &needs);
  // The driver takes the descriptor.
  VkImportMemoryFdInfoKHR import = {.sType = VK_STRUCTURE_TYPE_IMPORT_MEMORY_FD_INFO_KHR,
                                    .handleType = VK_EXTERNAL_MEMORY_HANDLE_TYPE_OPAQUE_FD_BIT,
                                    .fd = memory.fd};
  VkMemoryAllocateInfo allocate = {.sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO,
                                   .pNext = &import,
                                   .allocationSize = memory.bytes,
                                   .memoryTypeIndex = memory.memory_type};
  VK(vkAllocateMemory(own->device, &allocate, NULL, &made.memory));
  VK(vkBindBufferMemory(own->device, made.buffer, made.memory, 0));
  return made;
}

// Hands a shared buffer over to the library, or takes it back.
static void hand_over(struct own_vulkan *own, VkCommandBuffer commands, VkBuffer buffer, int to_library) {
  VkAccessFlags access = VK_ACCESS_TRANSFER_READ_BIT | VK_ACCESS_TRANSFER_WRITE_BIT;
  VkBufferMemoryBarrier barrier = {.sType = VK_STRUCTURE_TYPE_BUFFER_MEMORY_BARRIER,
                                   .srcAccessMask = to_library ? access : 0,
                                   .dstAccessMask = to_library ? 0 : access,
                                   .srcQueueFamilyIndex = to_library ? own->queue_family : VK_QUEUE_FAMILY_EXTERNAL,
                                   .dstQueueFamilyIndex = to_library ? VK_QUEUE_FAMILY_EXTERNAL : own->queue_family,
                                   .buffer = buffer,
                                   .size = VK_WHOLE_SIZE};
  VkPipelineStageFlags all = VK_PIPELINE_STAGE_ALL_COMMANDS_BIT;
  vkCmdPipelineBarrier(commands, all, all, 0, 0, NULL, 1, &barrier, 0, NULL);
}

static void copy(struct own_vulkan *own, const struct own_buffer *from, const struct own_buffer *to,
                 const struct own_buffer *shared) {
  VkCommandBuffer commands = own_begin(own);
  if (shared == from) hand_over(own, commands, shared->buffer, 0);
  VkBufferCopy all = {.size = BYTES};
  vkCmdCopyBuffer(commands, from->buffer, to->buffer, 1, &all);
  if (shared == to) hand_over(own, commands, shared->buffer, 1);
  own_barrier(commands, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_ACCESS_TRANSFER_WRITE_BIT, VK_PIPELINE_STAGE_HOST_BIT,
              VK_ACCESS_HOST_READ_BIT);
  own_wait(own, own_submit(own, commands));
}

// A pass from one shared buffer to another.
static vkdenoise_recorded *record(const vkdenoise_denoiser *denoiser, const vkdenoise_shared_buffer *from,
                                  const vkdenoise_shared_buffer *to) {
  vkdenoise_buffer_plane color = VKDENOISE_INIT(vkdenoise_buffer_plane);
  color.buffer = vkdenoise_shared_buffer_handle(from);
  color.size = BYTES;
  vkdenoise_buffer_plane output = color;
  output.buffer = vkdenoise_shared_buffer_handle(to);
  vkdenoise_buffer_frame frame = VKDENOISE_INIT(vkdenoise_buffer_frame);
  frame.color = &color;
  frame.output = &output;
  vkdenoise_pass *pass;
  DENOISE(vkdenoise_pass_create(denoiser, WIDTH, HEIGHT, &pass));
  vkdenoise_binding *binding;
  DENOISE(vkdenoise_pass_bind_buffers(pass, &frame, &binding));
  const vkdenoise_shared_buffer *shared[] = {from, to};
  vkdenoise_recorded *recorded;
  REFUSED(vkdenoise_recorded_create(pass, binding, NULL, NULL, 2, &recorded), VKDENOISE_STATUS_INVALID_ARGUMENT,
          "shared is NULL");
  DENOISE(vkdenoise_recorded_create(pass, binding, NULL, shared, 2, &recorded));
  // The recording keeps them.
  vkdenoise_binding_destroy(binding);
  vkdenoise_pass_destroy(pass);
  return recorded;
}

static vkdenoise_timeline_point at(const vkdenoise_timeline *timeline, uint64_t value) {
  vkdenoise_timeline_point point = VKDENOISE_INIT(vkdenoise_timeline_point);
  point.timeline = timeline;
  point.value = value;
  return point;
}

static uint64_t nanoseconds(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
}

static void expected(vkdenoise_denoiser *denoiser, float *samples) {
  vkdenoise_plane color = VKDENOISE_INIT(vkdenoise_plane);
  vkdenoise_plane_mut output = VKDENOISE_INIT(vkdenoise_plane_mut);
  color.samples = output.samples = samples;
  vkdenoise_frame frame = VKDENOISE_INIT(vkdenoise_frame);
  frame.width = WIDTH;
  frame.height = HEIGHT;
  frame.color = &color;
  frame.output = &output;
  DENOISE(vkdenoise_denoise(denoiser, &frame, NULL, NULL));
}

static void a_pass_between_two_values(struct own_vulkan *own, const vkdenoise_device *device,
                                      vkdenoise_denoiser *denoiser) {
  vkdenoise_shared_buffer *ours[2];
  struct own_buffer theirs[2];
  for (int i = 0; i < 2; i++) {
    DENOISE(vkdenoise_shared_buffer_create(device, BYTES, VKDENOISE_MEMORY_HANDLE_OPAQUE_FD, &ours[i]));
    theirs[i] = theirs_make(own, ours[i]);
  }
  struct own_buffer staging = own_buffer_make(own, BYTES);
  float *samples = staging.mapped, clean[SAMPLES];
  for (int i = 0; i < SAMPLES; i++) clean[i] = samples[i] = (float)((i * 37) % 101) / 50.0f;
  vkdenoise_recorded *recorded = record(denoiser, ours[0], ours[1]);
  vkdenoise_timeline *timeline;
  DENOISE(vkdenoise_timeline_create(device, 5, &timeline));
  vkdenoise_timeline_point before = at(timeline, 6), after = at(timeline, 7);
  uint32_t reached = 9, ended = 9;
  // As long as it takes to run thrice, whatever else the machine does.
  uint64_t start = nanoseconds();
  DENOISE(vkdenoise_recorded_submit(recorded, NULL, NULL));
  DENOISE(vkdenoise_recorded_wait(recorded, LONG, &ended));
  uint64_t thrice = 3 * (nanoseconds() - start) + 20000000;
  EXPECT(ended == 1);
  DENOISE(vkdenoise_recorded_submit(recorded, &before, &after));
  DENOISE(vkdenoise_timeline_wait(timeline, 7, thrice, &reached));
  DENOISE(vkdenoise_recorded_wait(recorded, 0, &ended));
  EXPECT(reached == 0 && ended == 0);
  copy(own, &staging, &theirs[0], &theirs[0]);
  DENOISE(vkdenoise_timeline_signal(timeline, 6));
  DENOISE(vkdenoise_timeline_wait(timeline, 7, LONG, &reached));
  DENOISE(vkdenoise_recorded_wait(recorded, LONG, &ended));
  uint64_t value = 0;
  DENOISE(vkdenoise_timeline_value(timeline, &value));
  EXPECT(reached == 1 && ended == 1 && value == 7);
  copy(own, &theirs[1], &staging, &theirs[1]);
  expected(denoiser, clean);
  EXPECT(memcmp(samples, clean, BYTES) == 0);

  const vkdenoise_status invalid = VKDENOISE_STATUS_INVALID_ARGUMENT;
  REFUSED(vkdenoise_timeline_signal(timeline, 7), invalid, "must be larger");
  REFUSED(vkdenoise_recorded_submit(recorded, NULL, &after), invalid, "must be larger");
  before.timeline = NULL;
  REFUSED(vkdenoise_recorded_submit(recorded, &before, NULL), invalid, "timeline");
  REFUSED(vkdenoise_timeline_wait(timeline, 7, 0, NULL), invalid, "reached is NULL");
  vkdenoise_timeline_destroy(timeline);
  vkdenoise_recorded_destroy(recorded);
  for (int i = 0; i < 2; i++) {
    vkdenoise_shared_buffer_destroy(ours[i]);
    own_buffer_destroy(own, &theirs[i]);
  }
  own_buffer_destroy(own, &staging);
}

// Our own memory, to a second device of the library's and back.
static void imports(const vkdenoise_device *device) {
  vkdenoise_device *other;
  DENOISE(vkdenoise_device_open(NULL, &other));
  vkdenoise_shared_buffer *buffer, *made;
  DENOISE(vkdenoise_shared_buffer_create(device, BYTES, VKDENOISE_MEMORY_HANDLE_OPAQUE_FD, &buffer));
  vkdenoise_shared_memory memory = VKDENOISE_INIT(vkdenoise_shared_memory);
  DENOISE(vkdenoise_shared_buffer_export(buffer, &memory));
  DENOISE(vkdenoise_shared_buffer_import(other, &memory, BYTES, &made));
  EXPECT(vkdenoise_shared_buffer_handle(made) != 0 && vkdenoise_device_memory_bytes(other) == 0);
  vkdenoise_shared_buffer_destroy(made);
  const vkdenoise_status invalid = VKDENOISE_STATUS_INVALID_ARGUMENT;
  REFUSED(vkdenoise_shared_buffer_import(other, &memory, memory.bytes + 1, &made), invalid, "shared memory");
  EXPECT(close(memory.fd) == 0); // it stayed ours
  REFUSED(vkdenoise_shared_buffer_import(other, &memory, BYTES, &made), invalid, "fd is");
  memory.fd = -1;
  REFUSED(vkdenoise_shared_buffer_import(other, &memory, BYTES, &made), invalid, "fd is -1");
  memory.handle = 2;
  REFUSED(vkdenoise_shared_buffer_import(other, &memory, BYTES, &made), invalid, "vkdenoise_memory_handle");
  vkdenoise_shared_buffer_destroy(buffer);
  vkdenoise_device_destroy(other);
}

static void semaphores(const vkdenoise_device *device, const vkdenoise_interop *interop) {
  vkdenoise_timeline *timeline, *other;
  DENOISE(vkdenoise_timeline_create(device, 3, &timeline));
  int32_t fd = -1;
  if ((interop->timeline_fd & VKDENOISE_TRANSFER_EXPORT) && (interop->timeline_fd & VKDENOISE_TRANSFER_IMPORT)) {
    DENOISE(vkdenoise_timeline_export(timeline, &fd));
    DENOISE(vkdenoise_timeline_import(device, fd, &other));
    EXPECT(close(fd) == 0);
    DENOISE(vkdenoise_timeline_signal(timeline, 4));
    uint64_t value = 0;
    DENOISE(vkdenoise_timeline_value(other, &value));
    EXPECT(value == 4);
    vkdenoise_timeline_destroy(other);
  } else {
    printf("not run here: the driver does not share timeline semaphores by file descriptors\n");
    REFUSED(vkdenoise_timeline_export(timeline, &fd), VKDENOISE_STATUS_UNSUPPORTED, "external_semaphore_fd");
    REFUSED(vkdenoise_timeline_import(device, 0, &other), VKDENOISE_STATUS_UNSUPPORTED, "external_semaphore_fd");
  }
  vkdenoise_timeline_destroy(timeline);
}

static void a_renderers_device_shares_its_own(struct own_vulkan *own) {
  vkdenoise_renderer renderer = own_handles(own);
  vkdenoise_device *theirs;
  DENOISE(vkdenoise_device_from_renderer(&renderer, &theirs));
  vkdenoise_interop interop = VKDENOISE_INIT(vkdenoise_interop);
  interop.opaque_fd = 9;
  DENOISE(vkdenoise_device_get_interop(theirs, &interop));
  EXPECT(interop.opaque_fd == 0 && interop.dma_buf == 0 && interop.timeline_fd == 0);
  vkdenoise_shared_buffer *buffer;
  vkdenoise_timeline *timeline;
  REFUSED(vkdenoise_shared_buffer_create(theirs, 4, 0, &buffer), VKDENOISE_STATUS_UNSUPPORTED, "OpaqueFd");
  REFUSED(vkdenoise_timeline_create(theirs, 0, &timeline), VKDENOISE_STATUS_BINDING, "renderer's");
  vkdenoise_device_destroy(theirs);
}

int main(void) {
  vkdenoise_device *device;
  vkdenoise_device_options options = VKDENOISE_INIT(vkdenoise_device_options);
  options.device = getenv("VKDENOISE_DEVICE");
  DENOISE(vkdenoise_device_open(&options, &device));
  vkdenoise_denoiser *denoiser;
  DENOISE(vkdenoise_denoiser_create(device, NULL, &denoiser));
  vkdenoise_interop interop = VKDENOISE_INIT(vkdenoise_interop);
  DENOISE(vkdenoise_device_get_interop(device, &interop));
  uint32_t both = VKDENOISE_TRANSFER_IMPORT | VKDENOISE_TRANSFER_EXPORT;
  int shares = (interop.opaque_fd & both) == both && !(interop.opaque_fd & VKDENOISE_TRANSFER_DEDICATED);
  struct own_vulkan own;
  own_vulkan_open_with(&own, shares ? VK_KHR_EXTERNAL_MEMORY_FD_EXTENSION_NAME : NULL);
  if (shares) {
    a_pass_between_two_values(&own, device, denoiser);
    imports(device);
  } else {
    printf("not run here: the driver does not share plain memory by opaque file descriptors\n");
  }
  semaphores(device, &interop);
  a_renderers_device_shares_its_own(&own);
  own_vulkan_close(&own);
  EXPECT(own.messages == 0);
  vkdenoise_denoiser_destroy(denoiser);
  vkdenoise_device_destroy(device);
  return failures > 0;
}
