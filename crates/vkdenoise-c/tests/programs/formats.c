// Planes of integers, octahedral normals and a depth buffer in a renderer's buffers: what planes of floats give that
// hold the same; and what makes no sense is refused.

#include "../../examples/own_vulkan.h"

#include <math.h>

enum { WIDTH = 40, HEIGHT = 28, PIXELS = WIDTH * HEIGHT };

static int failures;

#define EXPECT(condition)                                                                            \
  do {                                                                                               \
    if (!(condition)) {                                                                              \
      fprintf(stderr, "%s:%d: %s does not hold; last error: %s\n", __FILE__, __LINE__, #condition,   \
              vkdenoise_last_error());                                                               \
      failures++;                                                                                    \
    }                                                                                                \
  } while (0)

static vkdenoise_buffer_plane plane_of(const struct own_buffer *buffer, uint32_t format, uint64_t pixel_stride) {
  vkdenoise_buffer_plane plane = VKDENOISE_INIT(vkdenoise_buffer_plane);
  plane.buffer = (uint64_t)buffer->buffer;
  plane.size = buffer->size;
  plane.format = format;
  plane.pixel_stride = pixel_stride;
  return plane;
}

// Denoises the frame into the buffer.
static void run(struct own_vulkan *own, const vkdenoise_pass *pass, vkdenoise_buffer_frame frame,
                const struct own_buffer *result) {
  vkdenoise_buffer_plane output = plane_of(result, VKDENOISE_SAMPLE_FORMAT_F32, 0);
  frame.output = &output;
  vkdenoise_binding *binding;
  DENOISE(vkdenoise_pass_bind_buffers(pass, &frame, &binding));
  VkCommandBuffer commands = own_begin(own);
  DENOISE(vkdenoise_pass_record(pass, commands, binding, NULL));
  own_barrier(commands, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, VK_ACCESS_SHADER_WRITE_BIT, VK_PIPELINE_STAGE_HOST_BIT,
              VK_ACCESS_HOST_READ_BIT);
  own_wait(own, own_submit(own, commands));
  vkdenoise_binding_destroy(binding);
}

// The largest difference of two results, beside their size.
static float apart(const struct own_buffer *one, const struct own_buffer *two) {
  const float *a = one->mapped, *b = two->mapped;
  float most = 0.0f;
  for (int i = 0; i < 3 * PIXELS; i++) {
    float difference = fabsf(a[i] - b[i]) / (1.0f + fabsf(b[i]));
    if (!(difference <= most)) most = difference;
  }
  return most;
}

static void refused(const vkdenoise_pass *pass, vkdenoise_buffer_frame frame, vkdenoise_status wanted,
                    const char *words) {
  vkdenoise_binding *none;
  frame.output = frame.color;
  EXPECT(vkdenoise_pass_bind_buffers(pass, &frame, &none) == wanted);
  EXPECT(strstr(vkdenoise_last_error(), words));
}

int main(void) {
  struct own_vulkan own;
  own_vulkan_open(&own);
  vkdenoise_renderer renderer = own_handles(&own);
  vkdenoise_device *device;
  vkdenoise_denoiser *denoiser;
  vkdenoise_pass *pass;
  DENOISE(vkdenoise_device_from_renderer(&renderer, &device));
  DENOISE(vkdenoise_denoiser_create(device, NULL, &denoiser));
  DENOISE(vkdenoise_pass_create(denoiser, WIDTH, HEIGHT, &pass));

  struct own_buffer color = own_buffer_make(&own, 12 * PIXELS), albedo = own_buffer_make(&own, 12 * PIXELS);
  struct own_buffer normal = own_buffer_make(&own, 12 * PIXELS), depth = own_buffer_make(&own, 4 * PIXELS);
  struct own_buffer rgba8 = own_buffer_make(&own, 4 * PIXELS), rgb10a2 = own_buffer_make(&own, 4 * PIXELS);
  struct own_buffer octahedral = own_buffer_make(&own, 4 * PIXELS), z = own_buffer_make(&own, 4 * PIXELS);
  struct own_buffer expected = own_buffer_make(&own, 12 * PIXELS), found = own_buffer_make(&own, 12 * PIXELS);
  for (int i = 0; i < PIXELS; i++) {
    for (int c = 0; c < 3; c++) {
      int number = (3 * i + c) * 7919 % 256;
      ((float *)color.mapped)[3 * i + c] = 0.05f + (float)number / 100.0f;
      ((float *)albedo.mapped)[3 * i + c] = (float)number / 255.0f;
      ((uint8_t *)rgba8.mapped)[4 * i + c] = (uint8_t)number;
    }
    // The octahedron's point (16383, -9830) / 32767 and its normal, z above 0.
    ((int16_t *)octahedral.mapped)[2 * i] = 16383;
    ((int16_t *)octahedral.mapped)[2 * i + 1] = -9830;
    float x = 16383.0f / 32767.0f, y = -9830.0f / 32767.0f, up = 1.0f - x + y;
    float length = sqrtf(x * x + y * y + up * up);
    uint32_t word = 3u << 30;
    for (int c = 0; c < 3; c++) {
      float *to = (float *)normal.mapped + 3 * i + c;
      *to = (c == 0 ? x : c == 1 ? y : up) / length;
      word |= (uint32_t)lroundf((*to * 0.5f + 0.5f) * 1023.0f) << 10 * c;
    }
    ((uint32_t *)rgb10a2.mapped)[i] = word;
    // Powers of two, of which the depth buffer's numbers are exact.
    float distance = (float)(1 << i / WIDTH % 5);
    ((float *)depth.mapped)[i] = distance;
    ((float *)z.mapped)[i] = 0.25f / distance;
  }

  const uint32_t f32 = VKDENOISE_SAMPLE_FORMAT_F32;
  vkdenoise_buffer_plane floats[] = {plane_of(&color, f32, 0), plane_of(&albedo, f32, 0), plane_of(&normal, f32, 0),
                                     plane_of(&depth, f32, 0)};
  vkdenoise_buffer_plane coded[] = {plane_of(&rgba8, VKDENOISE_SAMPLE_FORMAT_UNORM8, 4),
                                    plane_of(&octahedral, VKDENOISE_SAMPLE_FORMAT_SNORM16, 0),
                                    plane_of(&rgb10a2, VKDENOISE_SAMPLE_FORMAT_RGB10A2_UNORM, 0),
                                    plane_of(&z, f32, 0)};
  vkdenoise_buffer_frame frame = VKDENOISE_INIT(vkdenoise_buffer_frame);
  frame.color = &floats[0];
  frame.albedo = &floats[1];
  frame.normal = &floats[2];
  frame.depth = &floats[3];
  run(&own, pass, frame, &expected);

  vkdenoise_buffer_frame other = frame;
  other.albedo = &coded[0];
  run(&own, pass, other, &found);
  EXPECT(apart(&found, &expected) <= 1e-5f);
  other = frame;
  other.normal = &coded[1];
  other.normal_encoding = VKDENOISE_NORMAL_ENCODING_OCTAHEDRAL;
  run(&own, pass, other, &found);
  EXPECT(apart(&found, &expected) <= 1e-5f);
  // Ten bits are off by 0.001.
  other.normal = &coded[2];
  other.normal_encoding = VKDENOISE_NORMAL_ENCODING_VECTOR;
  run(&own, pass, other, &found);
  EXPECT(apart(&found, &expected) <= 1e-2f);
  other = frame;
  other.depth = &coded[3];
  other.depth_encoding = VKDENOISE_DEPTH_ENCODING_PERSPECTIVE_REVERSED;
  other.depth_near = 0.25f;
  other.depth_far = INFINITY;
  run(&own, pass, other, &found);
  EXPECT(apart(&found, &expected) <= 1e-5f);
  // Its numbers as distances are another depth: the comparison sees it.
  other.depth_encoding = VKDENOISE_DEPTH_ENCODING_LINEAR;
  run(&own, pass, other, &found);
  EXPECT(apart(&found, &expected) > 1e-5f);

  other.depth_encoding = VKDENOISE_DEPTH_ENCODING_PERSPECTIVE;
  other.depth_far = 0.125f;
  refused(pass, other, VKDENOISE_STATUS_INVALID_ARGUMENT, "depth_encoding");
  other.depth_encoding = 5;
  refused(pass, other, VKDENOISE_STATUS_INVALID_ARGUMENT, "depth_encoding is 5");
  other = frame;
  other.normal_encoding = 3;
  refused(pass, other, VKDENOISE_STATUS_INVALID_ARGUMENT, "normal_encoding is 3");
  other = frame;
  other.color = &coded[0];
  refused(pass, other, VKDENOISE_STATUS_BINDING, "F32, F16");
  floats[1].format = 6;
  refused(pass, frame, VKDENOISE_STATUS_INVALID_ARGUMENT, "format is 6");

  vkdenoise_pass_destroy(pass);
  vkdenoise_denoiser_destroy(denoiser);
  vkdenoise_device_destroy(device);
  struct own_buffer *made[] = {&color,   &albedo,     &normal, &depth,    &rgba8,
                               &rgb10a2, &octahedral, &z,      &expected, &found};
  for (int i = 0; i < 10; i++) own_buffer_destroy(&own, made[i]);
  own_vulkan_close(&own);
  EXPECT(own.messages == 0);
  if (failures > 0) return fprintf(stderr, "%d expectations failed\n", failures), 1;
  puts("all as it should be");
  return 0;
}
