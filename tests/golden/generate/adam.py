"""Golden of optim/adam: ten steps of PyTorch's Adam on given gradients."""

import torch
from common import save

generator = torch.Generator().manual_seed(0)
STEPS, COUNT = 10, 100

param = torch.nn.Parameter(torch.rand(COUNT, generator=generator) * 2 - 1)
grads = torch.rand((STEPS, COUNT), generator=generator) * 2 - 1
optimizer = torch.optim.Adam([param], lr=0.02, betas=(0.8, 0.95), eps=1e-6)
tensors = {"param": param.detach().clone(), "grads": grads, "hyper": torch.tensor([0.02, 0.8, 0.95, 1e-6])}
history = []
for grad in grads:
    param.grad = grad.clone()
    optimizer.step()
    history.append(param.detach().clone())
state = optimizer.state[param]
tensors.update(history=torch.stack(history), exp_avg=state["exp_avg"], exp_avg_sq=state["exp_avg_sq"])
save("adam", tensors)
