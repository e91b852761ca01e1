// A renderer whose resolution changes: passes of two sizes in one arena, in the library's memory and in the renderer's
// own, with labels for a graphics debugger. The results are those of passes by themselves, the bytes add up, and the
// validation layer is silent.

#include "../../examples/own_vulkan.h"

enum { SIZES = 2, LARGEST = 96 * 64 };

static const vkdenoise_size sizes[SIZES] = {{48, 40}, {96, 64}};

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

static void render(float *color, vkdenoise_size size) {
  for (uint32_t i = 0; i < 3 * size.width * size.height; i++) color[i] = (float)((i * 37u) % 101u) / 50.0f;
}

// Denoises a frame of `size` in place; the result stays in `frame`.
static void run(struct own_vulkan *own, const vkdenoise_pass *pass, const struct own_buffer *frame,
                vkdenoise_size size) {
  render(frame->mapped, size);
  vkdenoise_buffer_plane color = VKDENOISE_INIT(vkdenoise_buffer_plane);
  color.buffer = (uint64_t)frame->buffer;
  color.size = frame->size;
  vkdenoise_buffer_frame planes = VKDENOISE_INIT(vkdenoise_buffer_frame);
  planes.color = planes.output = &color;
  vkdenoise_binding *binding;
  DENOISE(vkdenoise_pass_bind_buffers(pass, &planes, &binding));
  VkCommandBuffer commands = own_begin(own);
  DENOISE(vkdenoise_pass_record(pass, commands, binding, NULL));
  own_barrier(commands, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, VK_ACCESS_SHADER_WRITE_BIT, VK_PIPELINE_STAGE_HOST_BIT,
              VK_ACCESS_HOST_READ_BIT);
  own_wait(own, own_submit(own, commands));
  vkdenoise_binding_destroy(binding);
}

// Memory for the blocks, one after another in one buffer.
static struct own_buffer arena_memory(struct own_vulkan *own, const uint64_t *blocks, size_t count,
                                      vkdenoise_arena_block *placed) {
  struct own_buffer made = {0};
  uint64_t alignment = vkdenoise_arena_alignment();
  for (size_t i = 0; i < count; i++) {
    placed[i] = VKDENOISE_INIT(vkdenoise_arena_block);
    placed[i].offset = made.size;
    placed[i].bytes = blocks[i];
    made.size += (blocks[i] + alignment - 1) / alignment * alignment;
  }
  VkBufferCreateInfo info = {
      .sType = VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO, .size = made.size, .usage = vkdenoise_arena_usage()};
  VK(vkCreateBuffer(own->device, &info, NULL, &made.buffer));
  VkMemoryRequirements needs;
  vkGetBufferMemoryRequirements(own->device, made.buffer, &needs);
  made.memory = own_allocate(own, needs, VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT);
  VK(vkBindBufferMemory(own->device, made.buffer, made.memory, 0));
  for (size_t i = 0; i < count; i++) placed[i].buffer = (uint64_t)made.buffer;
  return made;
}

static void refusals(const vkdenoise_denoiser *denoiser, const vkdenoise_device *device, const vkdenoise_arena *arena,
                     vkdenoise_arena_block block) {
  const vkdenoise_status invalid = VKDENOISE_STATUS_INVALID_ARGUMENT;
  uint64_t blocks[8];
  size_t count = 0;
  vkdenoise_arena *none;
  vkdenoise_pass *pass;
  REFUSED(vkdenoise_denoiser_arena_required(denoiser, sizes, SIZES, blocks, &count), invalid, "room for 0 blocks");
  REFUSED(vkdenoise_denoiser_arena_required(denoiser, NULL, SIZES, blocks, &count), invalid, "sizes is NULL");
  REFUSED(vkdenoise_denoiser_arena_required(denoiser, sizes, SIZES, blocks, NULL), invalid, "block_count is NULL");
  blocks[0] = 0;
  REFUSED(vkdenoise_arena_create(device, blocks, 1, &none), invalid, "0 bytes");
  block.offset += 4;
  REFUSED(vkdenoise_arena_from_buffers(device, &block, 1, &none), invalid, "multiple of");
  block.buffer = 0;
  REFUSED(vkdenoise_arena_from_buffers(device, &block, 1, &none), invalid, "VK_NULL_HANDLE");
  REFUSED(vkdenoise_pass_create_in(denoiser, NULL, 8, 8, &pass), invalid, "arena is NULL");
  REFUSED(vkdenoise_pass_create_in(denoiser, arena, 2048, 2048, &pass), VKDENOISE_STATUS_FRAME_TOO_LARGE, "arena");
  EXPECT(!none && !pass);
}

int main(void) {
  struct own_vulkan own;
  own_vulkan_open(&own);
  vkdenoise_renderer renderer = own_handles(&own);
  renderer.enabled_features |= VKDENOISE_FEATURE_DEBUG_UTILS; // the instance has it, for the validation layer
  vkdenoise_device *device;
  DENOISE(vkdenoise_device_from_renderer(&renderer, &device));
  vkdenoise_options options = VKDENOISE_INIT(vkdenoise_options);
  options.keep_aux = 1;
  options.label_kernels = 1;
  vkdenoise_denoiser *denoiser;
  DENOISE(vkdenoise_denoiser_create(device, &options, &denoiser));

  uint64_t blocks[8];
  size_t count = 0;
  DENOISE(vkdenoise_denoiser_arena_required(denoiser, sizes, SIZES, NULL, &count));
  EXPECT(count == 1);
  DENOISE(vkdenoise_denoiser_arena_required(denoiser, sizes, SIZES, blocks, &count));
  vkdenoise_arena *arenas[2];
  DENOISE(vkdenoise_arena_create(device, blocks, count, &arenas[0]));
  vkdenoise_arena_block placed[8];
  struct own_buffer memory = arena_memory(&own, blocks, count, placed);
  DENOISE(vkdenoise_arena_from_buffers(device, placed, count, &arenas[1]));
  EXPECT(vkdenoise_arena_device_bytes(arenas[0]) == blocks[0] && vkdenoise_arena_device_bytes(arenas[1]) == 0);
  refusals(denoiser, device, arenas[0], placed[0]);

  // By itself first, then both sizes in turn, in either arena.
  struct own_buffer frame = own_buffer_make(&own, 3 * LARGEST * sizeof(float));
  float *expected[SIZES];
  uint64_t persistent[SIZES];
  for (int i = 0; i < SIZES; i++) {
    vkdenoise_pass *pass;
    DENOISE(vkdenoise_pass_create(denoiser, sizes[i].width, sizes[i].height, &pass));
    run(&own, pass, &frame, sizes[i]);
    expected[i] = malloc(frame.size);
    memcpy(expected[i], frame.mapped, frame.size);
    vkdenoise_memory needed = VKDENOISE_INIT(vkdenoise_memory);
    DENOISE(vkdenoise_denoiser_memory_required(denoiser, sizes[i].width, sizes[i].height, &needed));
    EXPECT(vkdenoise_pass_device_bytes(pass) == needed.arena + needed.persistent);
    EXPECT(needed.arena <= blocks[0] && needed.persistent > 0);
    persistent[i] = needed.persistent;
    vkdenoise_pass_destroy(pass);
  }
  for (int a = 0; a < 2; a++) {
    vkdenoise_pass *passes[SIZES];
    uint64_t bytes = vkdenoise_denoiser_device_bytes(denoiser) + blocks[0];
    for (int i = 0; i < SIZES; i++) {
      DENOISE(vkdenoise_pass_create_in(denoiser, arenas[a], sizes[i].width, sizes[i].height, &passes[i]));
      EXPECT(vkdenoise_pass_device_bytes(passes[i]) == persistent[i]);
      bytes += persistent[i];
    }
    EXPECT(vkdenoise_device_memory_bytes(device) == bytes);
    for (int round = 0; round < 4; round++) {
      int i = round % SIZES;
      run(&own, passes[i], &frame, sizes[i]);
      EXPECT(memcmp(frame.mapped, expected[i], 3 * sizes[i].width * sizes[i].height * sizeof(float)) == 0);
    }
    for (int i = 0; i < SIZES; i++) vkdenoise_pass_destroy(passes[i]);
  }
  for (int i = 0; i < SIZES; i++) free(expected[i]);
  vkdenoise_arena_destroy(arenas[0]);
  vkdenoise_arena_destroy(arenas[1]);
  vkdenoise_denoiser_destroy(denoiser);
  EXPECT(vkdenoise_device_memory_bytes(device) == 0);
  EXPECT(vkdenoise_arena_device_bytes(NULL) == 0 && vkdenoise_pass_device_bytes(NULL) == 0);
  vkdenoise_device_destroy(device);
  own_buffer_destroy(&own, &memory);
  own_buffer_destroy(&own, &frame);
  own_vulkan_close(&own);
  EXPECT(own.messages == 0);
  return failures > 0;
}
