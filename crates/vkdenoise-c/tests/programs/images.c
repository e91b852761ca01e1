// A renderer whose frame lies in images, the exposure in a buffer, signals in buffers beside either; and what the
// renderer's path refuses. The result is held against that of buffers, and the validation layer is silent.

#include "../../examples/own_vulkan.h"

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

#define REFUSED(call, wanted, words)                                                                 \
  do {                                                                                               \
    vkdenoise_status status_ = (call);                                                               \
    EXPECT(status_ == (wanted));                                                                     \
    EXPECT(strstr(vkdenoise_last_error(), words));                                                   \
  } while (0)

struct image {
  VkImage image;
  VkDeviceMemory memory;
  VkImageView view;
  VkFormat format;
};

static struct image image_make(struct own_vulkan *own, VkFormat format) {
  struct image made = {.format = format};
  VkImageCreateInfo info = {.sType = VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO,
                            .imageType = VK_IMAGE_TYPE_2D,
                            .format = format,
                            .extent = {WIDTH, HEIGHT, 1},
                            .mipLevels = 1,
                            .arrayLayers = 1,
                            .samples = VK_SAMPLE_COUNT_1_BIT,
                            .usage = VK_IMAGE_USAGE_SAMPLED_BIT | VK_IMAGE_USAGE_STORAGE_BIT |
                                     VK_IMAGE_USAGE_TRANSFER_SRC_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT};
  VK(vkCreateImage(own->device, &info, NULL, &made.image));
  VkMemoryRequirements needs;
  vkGetImageMemoryRequirements(own->device, made.image, &needs);
  made.memory = own_allocate(own, needs, 0);
  VK(vkBindImageMemory(own->device, made.image, made.memory, 0));
  VkImageViewCreateInfo view = {.sType = VK_STRUCTURE_TYPE_IMAGE_VIEW_CREATE_INFO,
                                .image = made.image,
                                .viewType = VK_IMAGE_VIEW_TYPE_2D,
                                .format = format,
                                .subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1}};
  VK(vkCreateImageView(own->device, &view, NULL, &made.view));
  return made;
}

static void image_destroy(struct own_vulkan *own, struct image *image) {
  vkDestroyImageView(own->device, image->view, NULL);
  vkDestroyImage(own->device, image->image, NULL);
  vkFreeMemory(own->device, image->memory, NULL);
}

static void to_layout(VkCommandBuffer commands, struct image *image, VkImageLayout from, VkImageLayout to) {
  VkImageMemoryBarrier barrier = {.sType = VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER,
                                  .srcAccessMask = VK_ACCESS_MEMORY_WRITE_BIT,
                                  .dstAccessMask = VK_ACCESS_MEMORY_READ_BIT | VK_ACCESS_MEMORY_WRITE_BIT,
                                  .oldLayout = from,
                                  .newLayout = to,
                                  .srcQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED,
                                  .dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED,
                                  .image = image->image,
                                  .subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1}};
  VkPipelineStageFlags all = VK_PIPELINE_STAGE_ALL_COMMANDS_BIT;
  vkCmdPipelineBarrier(commands, all, all, 0, 0, NULL, 0, NULL, 1, &barrier);
}

static const VkBufferImageCopy whole = {.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1},
                                        .imageExtent = {WIDTH, HEIGHT, 1}};

static void upload(VkCommandBuffer commands, const struct own_buffer *from, struct image *to, VkImageLayout layout) {
  to_layout(commands, to, VK_IMAGE_LAYOUT_UNDEFINED, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL);
  vkCmdCopyBufferToImage(commands, from->buffer, to->image, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL, 1, &whole);
  to_layout(commands, to, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL, layout);
}

static vkdenoise_image_plane image_plane(const struct image *image, VkImageLayout layout) {
  vkdenoise_image_plane plane = VKDENOISE_INIT(vkdenoise_image_plane);
  plane.view = (uint64_t)image->view;
  plane.format = image->format;
  plane.layout = layout;
  plane.width = WIDTH;
  plane.height = HEIGHT;
  return plane;
}

static vkdenoise_buffer_plane buffer_plane(const struct own_buffer *buffer, uint64_t pixel_stride) {
  vkdenoise_buffer_plane plane = VKDENOISE_INIT(vkdenoise_buffer_plane);
  plane.buffer = (uint64_t)buffer->buffer;
  plane.size = buffer->size;
  plane.pixel_stride = pixel_stride;
  return plane;
}

static void host_reads(VkCommandBuffer commands) {
  own_barrier(commands, VK_PIPELINE_STAGE_ALL_COMMANDS_BIT, VK_ACCESS_MEMORY_WRITE_BIT, VK_PIPELINE_STAGE_HOST_BIT,
              VK_ACCESS_HOST_READ_BIT);
}

static void refusals(const vkdenoise_pass *pass, const vkdenoise_pass *other, const vkdenoise_denoiser *denoiser,
                     VkCommandBuffer commands, const vkdenoise_buffer_frame *buffers,
                     const vkdenoise_image_frame *images, const vkdenoise_binding *binding) {
  const vkdenoise_status invalid = VKDENOISE_STATUS_INVALID_ARGUMENT, mismatch = VKDENOISE_STATUS_PLANE_MISMATCH;
  vkdenoise_binding *none;
  vkdenoise_buffer_frame frame = *buffers;
  vkdenoise_buffer_plane color = *buffers->color;
  frame.color = NULL;
  REFUSED(vkdenoise_pass_bind_buffers(pass, &frame, &none), invalid, "colour plane is NULL");
  frame.color = &color;
  color.buffer = 0;
  REFUSED(vkdenoise_pass_bind_buffers(pass, &frame, &none), invalid, "VK_NULL_HANDLE");
  color = *buffers->color;
  color.offset = 8;
  REFUSED(vkdenoise_pass_bind_buffers(pass, &frame, &none), mismatch, "colour");
  color = *buffers->color;
  color.row_stride = 3;
  REFUSED(vkdenoise_pass_bind_buffers(pass, &frame, &none), mismatch, "row_stride is 3");
  color.row_stride = ~(uint64_t)3;
  REFUSED(vkdenoise_pass_bind_buffers(pass, &frame, &none), mismatch, "beyond");
  REFUSED(vkdenoise_pass_bind_buffers(NULL, buffers, &none), invalid, "pass is NULL");
  REFUSED(vkdenoise_pass_bind_buffers(pass, NULL, &none), invalid, "vkdenoise_buffer_frame is NULL");

  vkdenoise_image_frame pictures = *images;
  vkdenoise_image_plane picture = *images->color;
  pictures.color = &picture;
  picture.format = VK_FORMAT_R8G8B8A8_UNORM;
  REFUSED(vkdenoise_pass_bind_images(pass, &pictures, &none), VKDENOISE_STATUS_BINDING, "Rgba8Unorm");
  picture.format = VK_FORMAT_R8_UNORM;
  REFUSED(vkdenoise_pass_bind_images(pass, &pictures, &none), invalid, "R8_UNORM");
  picture = *images->color;
  picture.layout = VK_IMAGE_LAYOUT_UNDEFINED;
  REFUSED(vkdenoise_pass_bind_images(pass, &pictures, &none), VKDENOISE_STATUS_BINDING, "UNDEFINED");
  picture = *images->color;
  picture.width++;
  REFUSED(vkdenoise_pass_bind_images(pass, &pictures, &none), mismatch, "image");
  pictures.color = pictures.output;
  REFUSED(vkdenoise_pass_bind_images(pass, &pictures, &none), VKDENOISE_STATUS_BINDING, "two images");

  REFUSED(vkdenoise_pass_record(pass, NULL, binding, NULL), invalid, "command buffer is NULL");
  REFUSED(vkdenoise_pass_record(pass, commands, NULL, NULL), invalid, "binding is NULL");
  REFUSED(vkdenoise_pass_record(other, commands, binding, NULL), VKDENOISE_STATUS_BINDING, "pass");
  vkdenoise_frame_options options = VKDENOISE_INIT(vkdenoise_frame_options);
  options.exposure_buffer = color.buffer;
  options.exposure_offset = 2;
  REFUSED(vkdenoise_pass_record(pass, commands, binding, &options), invalid, "exposure");
  options.exposure_offset = 0;
  options.exposure = 1.0f;
  REFUSED(vkdenoise_pass_record(pass, commands, binding, &options), invalid, "exposure_buffer are both set");

  // The host path needs a queue, and the renderer's is not the library's.
  static float pixel[3];
  vkdenoise_plane plane = VKDENOISE_INIT(vkdenoise_plane);
  vkdenoise_plane_mut output = VKDENOISE_INIT(vkdenoise_plane_mut);
  plane.samples = output.samples = pixel;
  vkdenoise_frame host = VKDENOISE_INIT(vkdenoise_frame);
  host.width = host.height = 1;
  host.color = &plane;
  host.output = &output;
  REFUSED(vkdenoise_denoise((vkdenoise_denoiser *)denoiser, &host, NULL, NULL), VKDENOISE_STATUS_BINDING, "renderer");
}

static uint32_t go_on(void *user, float share) {
  (void)user, (void)share;
  return 1;
}

// The colour once more as a part of itself, and the depth as a value, beside a frame in buffers and in images.
static void signals(struct own_vulkan *own, const vkdenoise_device *device, const vkdenoise_pass *without,
                    vkdenoise_buffer_frame buffers, const float *denoised, vkdenoise_image_frame images) {
  const vkdenoise_status invalid = VKDENOISE_STATUS_INVALID_ARGUMENT;
  vkdenoise_options options = VKDENOISE_INIT(vkdenoise_options);
  options.quality = VKDENOISE_QUALITY_HIGH;
  options.signals = 1;
  vkdenoise_denoiser *denoiser;
  vkdenoise_pass *pass;
  DENOISE(vkdenoise_denoiser_create(device, &options, &denoiser));
  DENOISE(vkdenoise_pass_create(denoiser, WIDTH, HEIGHT, &pass));
  struct own_buffer results[4];
  vkdenoise_buffer_plane outputs[4];
  vkdenoise_buffer_signal given[4];
  for (int i = 0; i < 4; i++) {
    results[i] = own_buffer_make(own, 16 * PIXELS);
    outputs[i] = buffer_plane(&results[i], 0);
    given[i] = VKDENOISE_INIT(vkdenoise_buffer_signal);
    given[i].plane = i % 2 == 0 ? buffers.color : buffers.depth;
    given[i].output = &outputs[i];
    given[i].kind = i % 2 == 0 ? VKDENOISE_SIGNAL_KIND_LIGHT : VKDENOISE_SIGNAL_KIND_VALUE;
    given[i].channels = i % 2 == 0 ? 0 : 1;
  }
  buffers.signals = &given[0];
  images.signals = &given[2];
  buffers.signal_count = images.signal_count = 2;
  vkdenoise_binding *none, *in_buffers, *in_images;
  REFUSED(vkdenoise_pass_bind_buffers(without, &buffers, &none), invalid, "made without them");
  REFUSED(vkdenoise_pass_bind_images(without, &images, &none), invalid, "made without them");
  outputs[0].format = VKDENOISE_SAMPLE_FORMAT_F16;
  REFUSED(vkdenoise_pass_bind_buffers(pass, &buffers, &none), VKDENOISE_STATUS_BINDING, "another type");
  outputs[0].format = VKDENOISE_SAMPLE_FORMAT_F32;
  outputs[0].size = 12;
  REFUSED(vkdenoise_pass_bind_buffers(pass, &buffers, &none), VKDENOISE_STATUS_PLANE_MISMATCH, "signal's output");
  outputs[0].size = results[0].size;
  given[1].plane = NULL;
  REFUSED(vkdenoise_pass_bind_buffers(pass, &buffers, &none), invalid, "signal plane is NULL");
  given[1].plane = buffers.depth;
  images.signals = NULL;
  REFUSED(vkdenoise_pass_bind_images(pass, &images, &none), invalid, "vkdenoise_buffer_signal is NULL");
  images.signals = &given[2];
  DENOISE(vkdenoise_pass_bind_buffers(pass, &buffers, &in_buffers));
  DENOISE(vkdenoise_pass_bind_images(pass, &images, &in_images));

  VkCommandBuffer commands = own_begin(own);
  vkdenoise_frame_options frame_options = VKDENOISE_INIT(vkdenoise_frame_options);
  frame_options.progress = go_on;
  REFUSED(vkdenoise_pass_record(pass, commands, in_buffers, &frame_options), invalid, "host path");
  DENOISE(vkdenoise_pass_record(pass, commands, in_buffers, NULL));
  DENOISE(vkdenoise_pass_record(pass, commands, in_images, NULL));
  host_reads(commands);
  own_wait(own, own_submit(own, commands));
  const float *part = results[0].mapped, *value = results[1].mapped;
  EXPECT(memcmp(part, results[2].mapped, 12 * PIXELS) == 0);
  EXPECT(memcmp(value, results[3].mapped, 4 * PIXELS) == 0);
  int within = 1, whole = 1;
  for (int i = 0; i < PIXELS; i++) {
    within &= 1.0f <= value[i] && value[i] <= (float)HEIGHT;
    // A part that is all of the light.
    for (int c = 0; c < 3; c++) {
      float off = part[3 * i + c] - denoised[4 * i + c], most = 1e-5f * denoised[4 * i + c];
      whole &= -most <= off && off <= most;
    }
  }
  EXPECT(within);
  EXPECT(whole);
  vkdenoise_binding_destroy(in_buffers);
  vkdenoise_binding_destroy(in_images);
  vkdenoise_pass_destroy(pass);
  vkdenoise_denoiser_destroy(denoiser);
  for (int i = 0; i < 4; i++) own_buffer_destroy(own, &results[i]);
}

int main(void) {
  struct own_vulkan own;
  own_vulkan_open(&own);
  vkdenoise_renderer renderer = own_handles(&own);
  vkdenoise_device *device;
  vkdenoise_denoiser *denoiser;
  vkdenoise_pass *pass, *other;
  DENOISE(vkdenoise_device_from_renderer(&renderer, &device));
  DENOISE(vkdenoise_denoiser_create(device, NULL, &denoiser));
  DENOISE(vkdenoise_pass_create(denoiser, WIDTH, HEIGHT, &pass));
  DENOISE(vkdenoise_pass_create(denoiser, 8, 8, &other));

  struct own_buffer color = own_buffer_make(&own, 16 * PIXELS), normal = own_buffer_make(&own, 16 * PIXELS);
  struct own_buffer depth = own_buffer_make(&own, 4 * PIXELS), exposure = own_buffer_make(&own, 16);
  struct own_buffer by_buffers = own_buffer_make(&own, 16 * PIXELS), by_images = own_buffer_make(&own, 16 * PIXELS);
  float *rgba = color.mapped, *xyzw = normal.mapped, *distance = depth.mapped;
  for (int i = 0; i < PIXELS; i++) {
    for (int c = 0; c < 4; c++) {
      rgba[4 * i + c] = 0.05f + (float)((4 * i + c) * 7919 % 89) / 40.0f;
      xyzw[4 * i + c] = c == 2 ? 1.0f : 0.0f;
    }
    distance[i] = 1.0f + (float)(i / WIDTH);
  }
  ((float *)exposure.mapped)[1] = 0.75f;

  vkdenoise_buffer_plane planes[] = {buffer_plane(&color, 16), buffer_plane(&normal, 16), buffer_plane(&depth, 0),
                                     buffer_plane(&by_buffers, 16)};
  vkdenoise_buffer_frame buffers = VKDENOISE_INIT(vkdenoise_buffer_frame);
  buffers.color = &planes[0];
  buffers.normal = &planes[1];
  buffers.depth = &planes[2];
  buffers.output = &planes[3];
  const VkImageLayout read = VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL, general = VK_IMAGE_LAYOUT_GENERAL;
  struct image pictures[] = {
      image_make(&own, VK_FORMAT_R32G32B32A32_SFLOAT), image_make(&own, VK_FORMAT_R32G32B32A32_SFLOAT),
      image_make(&own, VK_FORMAT_R32_SFLOAT), image_make(&own, VK_FORMAT_R32G32B32A32_SFLOAT)};
  vkdenoise_image_plane views[] = {image_plane(&pictures[0], read), image_plane(&pictures[1], general),
                                   image_plane(&pictures[2], read), image_plane(&pictures[3], general)};
  vkdenoise_image_frame images = VKDENOISE_INIT(vkdenoise_image_frame);
  images.color = &views[0];
  images.normal = &views[1];
  images.depth = &views[2];
  images.output = &views[3];
  vkdenoise_binding *in_buffers, *in_images;
  DENOISE(vkdenoise_pass_bind_buffers(pass, &buffers, &in_buffers));
  DENOISE(vkdenoise_pass_bind_images(pass, &images, &in_images));

  VkCommandBuffer commands = own_begin(&own);
  refusals(pass, other, denoiser, commands, &buffers, &images, in_buffers);
  upload(commands, &color, &pictures[0], read);
  upload(commands, &normal, &pictures[1], general);
  upload(commands, &depth, &pictures[2], read);
  to_layout(commands, &pictures[3], VK_IMAGE_LAYOUT_UNDEFINED, general);
  vkdenoise_frame_options options = VKDENOISE_INIT(vkdenoise_frame_options);
  options.exposure_buffer = (uint64_t)exposure.buffer;
  options.exposure_offset = 4;
  options.statistics_buffer = 0;
  DENOISE(vkdenoise_pass_record(pass, commands, in_buffers, &options));
  DENOISE(vkdenoise_pass_record(pass, commands, in_images, &options));
  to_layout(commands, &pictures[3], general, VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL);
  vkCmdCopyImageToBuffer(commands, pictures[3].image, VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL, by_images.buffer, 1,
                         &whole);
  host_reads(commands);
  own_wait(&own, own_submit(&own, commands));

  const float *first = by_buffers.mapped, *second = by_images.mapped;
  for (int i = 0; i < PIXELS; i++) {
    const float *one = first + 4 * i, *two = second + 4 * i;
    if (memcmp(one, two, 12) == 0 && one[0] > 0.0f && two[3] == rgba[4 * i + 3]) continue;
    fprintf(stderr, "pixel %d: %g in buffers, %g in images, alpha %g\n", i, one[0], two[0], two[3]);
    failures++;
    break;
  }

  // The exposure was the buffer's.
  options = VKDENOISE_INIT(vkdenoise_frame_options);
  options.exposure = 0.75f;
  options.statistics_buffer = (uint64_t)exposure.buffer;
  commands = own_begin(&own);
  DENOISE(vkdenoise_pass_record(pass, commands, in_buffers, &options));
  host_reads(commands);
  own_wait(&own, own_submit(&own, commands));
  EXPECT(*(float *)exposure.mapped == 0.75f);
  EXPECT(memcmp(first, second, 12) == 0);

  // The same normals as points of an octahedron: its middle, zeros. The images' output is in another layout now.
  struct image octahedral = image_make(&own, VK_FORMAT_R16G16_SFLOAT);
  vkdenoise_image_plane points = image_plane(&octahedral, read);
  struct own_buffer middle = own_buffer_make(&own, 4 * PIXELS);
  memset(middle.mapped, 0, 4 * PIXELS);
  images.normal = &points;
  vkdenoise_binding *none, *with_points;
  REFUSED(vkdenoise_pass_bind_images(pass, &images, &none), VKDENOISE_STATUS_BINDING, "Octahedral");
  images.normal_encoding = VKDENOISE_NORMAL_ENCODING_OCTAHEDRAL;
  DENOISE(vkdenoise_pass_bind_images(pass, &images, &with_points));
  options.statistics_buffer = 0;
  commands = own_begin(&own);
  upload(commands, &middle, &octahedral, read);
  to_layout(commands, &pictures[3], VK_IMAGE_LAYOUT_UNDEFINED, general);
  DENOISE(vkdenoise_pass_record(pass, commands, with_points, &options));
  to_layout(commands, &pictures[3], general, VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL);
  vkCmdCopyImageToBuffer(commands, pictures[3].image, VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL, by_images.buffer, 1,
                         &whole);
  to_layout(commands, &pictures[3], VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL, general);
  host_reads(commands);
  own_wait(&own, own_submit(&own, commands));
  int same = 1;
  for (int i = 0; i < PIXELS; i++) same &= memcmp(first + 4 * i, second + 4 * i, 12) == 0;
  EXPECT(same);
  vkdenoise_binding_destroy(with_points);
  image_destroy(&own, &octahedral);
  own_buffer_destroy(&own, &middle);
  images.normal = &views[1];
  images.normal_encoding = VKDENOISE_NORMAL_ENCODING_VECTOR;
  signals(&own, device, pass, buffers, first, images);

  vkdenoise_binding_destroy(in_buffers);
  vkdenoise_binding_destroy(in_images);
  vkdenoise_pass_destroy(pass);
  vkdenoise_pass_destroy(other);
  vkdenoise_denoiser_destroy(denoiser);
  vkdenoise_device_destroy(device);
  for (int i = 0; i < 4; i++) image_destroy(&own, &pictures[i]);
  struct own_buffer *made[] = {&color, &normal, &depth, &exposure, &by_buffers, &by_images};
  for (int i = 0; i < 6; i++) own_buffer_destroy(&own, made[i]);
  own_vulkan_close(&own);
  EXPECT(own.messages == 0);
  if (failures > 0) return fprintf(stderr, "%d expectations failed\n", failures), 1;
  puts("all as it should be");
  return 0;
}
