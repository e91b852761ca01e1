"""Training kit of vkdenoise: the joint-attention denoising networks in PyTorch, their data, training and export."""
