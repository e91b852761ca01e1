// A renderer in C: its own Vulkan device, the denoiser recorded into its command buffers, two frames in flight, the
// validation layer listening. Each frame's input is filled by the GPU in the same command buffer (a copy stands for
// the renderer's passes).

#include <math.h>

#include "own_vulkan.h"

enum { WIDTH = 96, HEIGHT = 72, PIXELS = WIDTH * HEIGHT, IN_FLIGHT = 2, FRAMES = 4 };

// One of the frames in flight. All input planes lie in one buffer: colour, albedo (three floats a pixel each), depth.
struct slot {
  struct own_buffer upload, input, output, statistics;
  vkdenoise_binding *binding;
  VkFence fence;
};

static float random01(uint32_t *state) {
  *state = *state * 1664525u + 1013904223u;
  return (float)(*state >> 8) / 16777216.0f;
}

// A board of two colours in fog.
static void truth(int pixel, float rgb[3], float albedo[3], float *depth) {
  int x = pixel % WIDTH, y = pixel / WIDTH, odd = (x / 16 + y / 16) % 2;
  *depth = 2.0f + (float)y / HEIGHT;
  for (int c = 0; c < 3; c++) {
    albedo[c] = odd ? 0.8f : 0.1f + 0.1f * c;
    rgb[c] = albedo[c] / *depth;
  }
}

static void render(void *mapped, uint32_t seed) {
  float *color = mapped, *albedo = color + 3 * PIXELS, *depth = albedo + 3 * PIXELS;
  for (int i = 0; i < PIXELS; i++) {
    truth(i, color + 3 * i, albedo + 3 * i, depth + i);
    float noise = -logf(1.0f - random01(&seed)) * 0.5f - logf(1.0f - random01(&seed)) * 0.5f;
    for (int c = 0; c < 3; c++) color[3 * i + c] *= noise;
  }
}

static double error_of(const float *rgb) {
  double sum = 0.0;
  for (int i = 0; i < PIXELS; i++) {
    float clean[3], albedo[3], depth;
    truth(i, clean, albedo, &depth);
    for (int c = 0; c < 3; c++) sum += fabs(rgb[3 * i + c] - clean[c]);
  }
  return sum / (3 * PIXELS);
}

static vkdenoise_buffer_plane plane(const struct own_buffer *buffer, uint64_t offset) {
  vkdenoise_buffer_plane plane = VKDENOISE_INIT(vkdenoise_buffer_plane);
  plane.buffer = (uint64_t)buffer->buffer;
  plane.size = buffer->size;
  plane.offset = offset;
  return plane;
}

static void slot_make(struct slot *slot, struct own_vulkan *own, const vkdenoise_pass *pass) {
  VkDeviceSize size = 7 * PIXELS * sizeof(float);
  slot->upload = own_buffer_make(own, size);
  slot->input = own_buffer_make(own, size);
  slot->output = own_buffer_make(own, 3 * PIXELS * sizeof(float));
  slot->statistics = own_buffer_make(own, 4 * sizeof(float));
  vkdenoise_buffer_plane color = plane(&slot->input, 0);
  vkdenoise_buffer_plane albedo = plane(&slot->input, 3 * PIXELS * sizeof(float));
  vkdenoise_buffer_plane depth = plane(&slot->input, 6 * PIXELS * sizeof(float));
  vkdenoise_buffer_plane output = plane(&slot->output, 0);
  vkdenoise_buffer_frame frame = VKDENOISE_INIT(vkdenoise_buffer_frame);
  frame.color = &color;
  frame.albedo = &albedo;
  frame.depth = &depth;
  frame.output = &output;
  DENOISE(vkdenoise_pass_bind_buffers(pass, &frame, &slot->binding));
}

static void slot_submit(struct slot *slot, struct own_vulkan *own, const vkdenoise_pass *pass, uint32_t seed) {
  render(slot->upload.mapped, seed);
  VkCommandBuffer commands = own_begin(own);
  VkBufferCopy all = {.size = slot->input.size};
  vkCmdCopyBuffer(commands, slot->upload.buffer, slot->input.buffer, 1, &all);
  // The denoiser reads in compute shaders what was written before it.
  own_barrier(commands, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_ACCESS_TRANSFER_WRITE_BIT,
              VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, VK_ACCESS_SHADER_READ_BIT);
  vkdenoise_frame_options options = VKDENOISE_INIT(vkdenoise_frame_options);
  options.statistics_buffer = (uint64_t)slot->statistics.buffer;
  DENOISE(vkdenoise_pass_record(pass, commands, slot->binding, &options));
  // It wrote in compute shaders; here the host reads.
  own_barrier(commands, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, VK_ACCESS_SHADER_WRITE_BIT,
              VK_PIPELINE_STAGE_HOST_BIT, VK_ACCESS_HOST_READ_BIT);
  slot->fence = own_submit(own, commands);
}

static int slot_finish(struct slot *slot, struct own_vulkan *own, int frame) {
  own_wait(own, slot->fence);
  double before = error_of(slot->upload.mapped), after = error_of(slot->output.mapped);
  const float *statistics = slot->statistics.mapped;
  printf("frame %d: mean error noisy %.4f, denoised %.4f; exposure %.3f\n", frame, before, after, statistics[0]);
  return after < before / 4.0 && statistics[0] > 0.0f;
}

static void slot_destroy(struct slot *slot, struct own_vulkan *own) {
  vkdenoise_binding_destroy(slot->binding);
  own_buffer_destroy(own, &slot->upload);
  own_buffer_destroy(own, &slot->input);
  own_buffer_destroy(own, &slot->output);
  own_buffer_destroy(own, &slot->statistics);
}

int main(void) {
  struct own_vulkan own;
  own_vulkan_open(&own);

  vkdenoise_renderer renderer = own_handles(&own);
  vkdenoise_device *device;
  DENOISE(vkdenoise_device_from_renderer(&renderer, &device));
  vkdenoise_denoiser *denoiser;
  DENOISE(vkdenoise_denoiser_create(device, NULL, &denoiser));
  vkdenoise_memory memory = VKDENOISE_INIT(vkdenoise_memory);
  DENOISE(vkdenoise_denoiser_memory_required(denoiser, WIDTH, HEIGHT, &memory));
  printf("%.1f MB of maps, %.1f MB of weights\n", memory.arena / 1e6, memory.weights / 1e6);
  vkdenoise_pass *pass;
  DENOISE(vkdenoise_pass_create(denoiser, WIDTH, HEIGHT, &pass));

  struct slot slots[IN_FLIGHT] = {0};
  for (int i = 0; i < IN_FLIGHT; i++) slot_make(&slots[i], &own, pass);
  int good = 1;
  for (int frame = 0; frame < FRAMES; frame++) {
    struct slot *slot = &slots[frame % IN_FLIGHT];
    // The frame before the last has finished; the last may still run.
    if (frame >= IN_FLIGHT) good &= slot_finish(slot, &own, frame - IN_FLIGHT);
    slot_submit(slot, &own, pass, 1 + (uint32_t)frame);
  }
  for (int frame = FRAMES; frame < FRAMES + IN_FLIGHT; frame++)
    good &= slot_finish(&slots[frame % IN_FLIGHT], &own, frame - IN_FLIGHT);

  for (int i = 0; i < IN_FLIGHT; i++) slot_destroy(&slots[i], &own);
  vkdenoise_pass_destroy(pass);
  vkdenoise_denoiser_destroy(denoiser);
  vkdenoise_device_destroy(device);
  own_vulkan_close(&own);
  if (own.messages > 0) fprintf(stderr, "the validation layer spoke %u times\n", own.messages);
  if (!good) fprintf(stderr, "a denoised frame is not a quarter as far from the truth as the noisy one\n");
  return good && own.messages == 0 ? 0 : 1;
}
