// A small renderer's own Vulkan for the examples: instance, validation layer, device, queue, buffers, submissions.
// Nothing here is of vkdenoise but the features that are enabled. What fails ends the program.

#ifndef OWN_VULKAN_H
#define OWN_VULKAN_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <vkdenoise.h>
#include <vulkan/vulkan.h>

struct own_vulkan {
  VkInstance instance;
  VkDebugUtilsMessengerEXT messenger;
  VkPhysicalDevice physical_device;
  VkDevice device;
  uint32_t queue_family;
  VkQueue queue;
  VkCommandPool pool;
  // The sum of vkdenoise_feature values that are enabled.
  uint32_t enabled_features;
  // What the validation layer said.
  unsigned messages;
};

struct own_buffer {
  VkBuffer buffer;
  VkDeviceMemory memory;
  VkDeviceSize size;
  void *mapped;
};

static inline void vk_check(VkResult result, const char *call) {
  if (result == VK_SUCCESS) return;
  fprintf(stderr, "%s failed: %d\n", call, result);
  exit(1);
}
#define VK(call) vk_check(call, #call)

static inline VKAPI_ATTR VkBool32 VKAPI_CALL own_on_message(VkDebugUtilsMessageSeverityFlagBitsEXT severity,
                                                     VkDebugUtilsMessageTypeFlagsEXT types,
                                                     const VkDebugUtilsMessengerCallbackDataEXT *data, void *user) {
  (void)severity, (void)types;
  fprintf(stderr, "validation: %s\n", data->pMessage);
  ++*(unsigned *)user;
  return VK_FALSE;
}

static inline void own_make_instance(struct own_vulkan *own) {
  VkApplicationInfo application = {.sType = VK_STRUCTURE_TYPE_APPLICATION_INFO, .apiVersion = VK_API_VERSION_1_2};
  const char *layers[] = {"VK_LAYER_KHRONOS_validation"};
  const char *extensions[] = {VK_EXT_DEBUG_UTILS_EXTENSION_NAME, VK_EXT_VALIDATION_FEATURES_EXTENSION_NAME};
  VkValidationFeatureEnableEXT synchronisation = VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT;
  VkValidationFeaturesEXT validation = {.sType = VK_STRUCTURE_TYPE_VALIDATION_FEATURES_EXT,
                                        .enabledValidationFeatureCount = 1,
                                        .pEnabledValidationFeatures = &synchronisation};
  VkInstanceCreateInfo instance = {.sType = VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO,
                                   .pNext = &validation,
                                   .pApplicationInfo = &application,
                                   .enabledLayerCount = 1,
                                   .ppEnabledLayerNames = layers,
                                   .enabledExtensionCount = 2,
                                   .ppEnabledExtensionNames = extensions};
  VK(vkCreateInstance(&instance, NULL, &own->instance));
  VkDebugUtilsMessengerCreateInfoEXT messenger = {
      .sType = VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT,
      .messageSeverity =
          VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT,
      .messageType = VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT,
      .pfnUserCallback = own_on_message,
      .pUserData = &own->messages};
  PFN_vkCreateDebugUtilsMessengerEXT create =
      (PFN_vkCreateDebugUtilsMessengerEXT)vkGetInstanceProcAddr(own->instance, "vkCreateDebugUtilsMessengerEXT");
  VK(create(own->instance, &messenger, NULL, &own->messenger));
}

// The device whose number or part of whose name VKDENOISE_DEVICE says; else the first.
static inline void own_pick_device(struct own_vulkan *own) {
  VkPhysicalDevice found[16];
  uint32_t count = 16, at = 0;
  vkEnumeratePhysicalDevices(own->instance, &count, found);
  const char *wanted = getenv("VKDENOISE_DEVICE");
  for (uint32_t i = 0; wanted && i < count; i++) {
    VkPhysicalDeviceProperties properties;
    vkGetPhysicalDeviceProperties(found[i], &properties);
    char number[12];
    snprintf(number, sizeof number, "%u", i);
    if (strcmp(number, wanted) == 0 || strstr(properties.deviceName, wanted)) at = i;
  }
  if (count == 0) fprintf(stderr, "there is no Vulkan driver\n"), exit(1);
  own->physical_device = found[at];
  VkQueueFamilyProperties families[16];
  count = 16;
  vkGetPhysicalDeviceQueueFamilyProperties(own->physical_device, &count, families);
  while (own->queue_family < count && !(families[own->queue_family].queueFlags & VK_QUEUE_COMPUTE_BIT))
    own->queue_family++;
}

// `extension`: one more to enable, or NULL.
static inline void own_make_device(struct own_vulkan *own, const char *extension) {
  VkPhysicalDeviceVulkan12Features has12 = {.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES};
  VkPhysicalDeviceVulkan11Features has11 = {.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_1_FEATURES,
                                            .pNext = &has12};
  VkPhysicalDeviceFeatures2 has = {.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2, .pNext = &has11};
  vkGetPhysicalDeviceFeatures2(own->physical_device, &has);
  // What the denoiser needs, and of what it can use that which is there.
  VkPhysicalDeviceVulkan12Features enable12 = {.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES,
                                               .bufferDeviceAddress = VK_TRUE,
                                               .subgroupBroadcastDynamicId = has12.subgroupBroadcastDynamicId};
  VkPhysicalDeviceVulkan11Features enable11 = {.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_1_FEATURES,
                                               .pNext = &enable12,
                                               .storageBuffer16BitAccess = has11.storageBuffer16BitAccess};
  VkPhysicalDeviceFeatures2 enable = {.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2,
                                      .pNext = &enable11,
                                      .features.shaderInt64 = has.features.shaderInt64};
  if (enable12.subgroupBroadcastDynamicId) own->enabled_features |= VKDENOISE_FEATURE_SUBGROUP_BROADCAST_DYNAMIC_ID;
  if (enable11.storageBuffer16BitAccess) own->enabled_features |= VKDENOISE_FEATURE_STORAGE16;
  if (enable.features.shaderInt64) own->enabled_features |= VKDENOISE_FEATURE_SHADER_INT64;

  float priority = 1.0f;
  VkDeviceQueueCreateInfo queue = {.sType = VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO,
                                   .queueFamilyIndex = own->queue_family,
                                   .queueCount = 1,
                                   .pQueuePriorities = &priority};
  VkDeviceCreateInfo device = {.sType = VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO,
                               .pNext = &enable,
                               .queueCreateInfoCount = 1,
                               .pQueueCreateInfos = &queue,
                               .enabledExtensionCount = extension ? 1 : 0,
                               .ppEnabledExtensionNames = &extension};
  VK(vkCreateDevice(own->physical_device, &device, NULL, &own->device));
  vkGetDeviceQueue(own->device, own->queue_family, 0, &own->queue);
  VkCommandPoolCreateInfo pool = {.sType = VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO,
                                  .queueFamilyIndex = own->queue_family};
  VK(vkCreateCommandPool(own->device, &pool, NULL, &own->pool));
}

// `own` must stay where it is: the messenger counts in it.
static inline void own_vulkan_open_with(struct own_vulkan *own, const char *extension) {
  memset(own, 0, sizeof *own);
  own_make_instance(own);
  own_pick_device(own);
  own_make_device(own, extension);
}

static inline void own_vulkan_open(struct own_vulkan *own) { own_vulkan_open_with(own, NULL); }

static inline void own_vulkan_close(struct own_vulkan *own) {
  vkDestroyCommandPool(own->device, own->pool, NULL);
  vkDestroyDevice(own->device, NULL);
  PFN_vkDestroyDebugUtilsMessengerEXT destroy =
      (PFN_vkDestroyDebugUtilsMessengerEXT)vkGetInstanceProcAddr(own->instance, "vkDestroyDebugUtilsMessengerEXT");
  destroy(own->instance, own->messenger, NULL);
  vkDestroyInstance(own->instance, NULL);
}

static inline VkDeviceMemory own_allocate(struct own_vulkan *own, VkMemoryRequirements needs,
                                          VkMemoryPropertyFlags wanted) {
  VkPhysicalDeviceMemoryProperties memory;
  vkGetPhysicalDeviceMemoryProperties(own->physical_device, &memory);
  uint32_t type = 0;
  while (!(needs.memoryTypeBits & (1u << type)) || (memory.memoryTypes[type].propertyFlags & wanted) != wanted) {
    if (++type == memory.memoryTypeCount) fprintf(stderr, "there is no memory of this type\n"), exit(1);
  }
  VkMemoryAllocateFlagsInfo address = {.sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_FLAGS_INFO,
                                       .flags = VK_MEMORY_ALLOCATE_DEVICE_ADDRESS_BIT};
  VkMemoryAllocateInfo info = {.sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO,
                               .pNext = &address,
                               .allocationSize = needs.size,
                               .memoryTypeIndex = type};
  VkDeviceMemory allocated;
  VK(vkAllocateMemory(own->device, &info, NULL, &allocated));
  return allocated;
}

// A buffer that the denoiser can reach, mapped for the host.
static inline struct own_buffer own_buffer_make(struct own_vulkan *own, VkDeviceSize size) {
  struct own_buffer made = {.size = size};
  VkBufferCreateInfo info = {.sType = VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO,
                             .size = size,
                             .usage = VK_BUFFER_USAGE_STORAGE_BUFFER_BIT | VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT |
                                      VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT};
  VK(vkCreateBuffer(own->device, &info, NULL, &made.buffer));
  VkMemoryRequirements needs;
  vkGetBufferMemoryRequirements(own->device, made.buffer, &needs);
  made.memory =
      own_allocate(own, needs, VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT);
  VK(vkBindBufferMemory(own->device, made.buffer, made.memory, 0));
  VK(vkMapMemory(own->device, made.memory, 0, size, 0, &made.mapped));
  memset(made.mapped, 0, size);
  return made;
}

static inline void own_buffer_destroy(struct own_vulkan *own, struct own_buffer *buffer) {
  vkDestroyBuffer(own->device, buffer->buffer, NULL);
  vkFreeMemory(own->device, buffer->memory, NULL);
}

static inline VkCommandBuffer own_begin(struct own_vulkan *own) {
  VkCommandBufferAllocateInfo info = {.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO,
                                      .commandPool = own->pool,
                                      .level = VK_COMMAND_BUFFER_LEVEL_PRIMARY,
                                      .commandBufferCount = 1};
  VkCommandBuffer commands;
  VK(vkAllocateCommandBuffers(own->device, &info, &commands));
  VkCommandBufferBeginInfo begin = {.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
  VK(vkBeginCommandBuffer(commands, &begin));
  return commands;
}

// Ends and submits; the fence says when the commands have run.
static inline VkFence own_submit(struct own_vulkan *own, VkCommandBuffer commands) {
  VK(vkEndCommandBuffer(commands));
  VkFenceCreateInfo info = {.sType = VK_STRUCTURE_TYPE_FENCE_CREATE_INFO};
  VkFence fence;
  VK(vkCreateFence(own->device, &info, NULL, &fence));
  VkSubmitInfo submit = {
      .sType = VK_STRUCTURE_TYPE_SUBMIT_INFO, .commandBufferCount = 1, .pCommandBuffers = &commands};
  VK(vkQueueSubmit(own->queue, 1, &submit, fence));
  return fence;
}

static inline void own_wait(struct own_vulkan *own, VkFence fence) {
  VK(vkWaitForFences(own->device, 1, &fence, VK_TRUE, UINT64_MAX));
  vkDestroyFence(own->device, fence, NULL);
}

// What one stage wrote is visible to another.
static inline void own_barrier(VkCommandBuffer commands, VkPipelineStageFlags from, VkAccessFlags wrote,
                        VkPipelineStageFlags to, VkAccessFlags reads) {
  VkMemoryBarrier barrier = {
      .sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER, .srcAccessMask = wrote, .dstAccessMask = reads};
  vkCmdPipelineBarrier(commands, from, to, 0, 1, &barrier, 0, NULL, 0, NULL);
}

// This renderer, as the denoiser takes it.
static inline vkdenoise_renderer own_handles(struct own_vulkan *own) {
  vkdenoise_renderer renderer = VKDENOISE_INIT(vkdenoise_renderer);
  renderer.get_instance_proc_addr = (vkdenoise_function)vkGetInstanceProcAddr;
  renderer.instance = own->instance;
  renderer.physical_device = own->physical_device;
  renderer.device = own->device;
  renderer.queue_family = own->queue_family;
  renderer.enabled_features = own->enabled_features;
  renderer.cache = "off";
  // Nothing else is submitted while a denoiser is created.
  renderer.upload_queue = own->queue;
  return renderer;
}

static inline void denoise_check(vkdenoise_status status, const char *call) {
  if (status == VKDENOISE_STATUS_OK) return;
  fprintf(stderr, "%s: %s\n", call, vkdenoise_last_error());
  exit(1);
}
#define DENOISE(call) denoise_check(call, #call)

#endif
