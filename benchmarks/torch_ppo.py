#!/usr/bin/env python3
"""Peer of bench_ppo: the same PPO minibatch step in PyTorch, one thread, CPU time.

14 observations, separate actor and critic 2 x 128 tanh, branches 3 3 3 2, joint ratio, entropy bonus, squared value
error, gradient norm clipped to 0.5, Adam; rows gathered from a shuffled batch of 10 240 as in bench_ppo. Prints
`ppo.torch_us_per_sample_epoch VALUE us`, best of several epochs. Without torch it says so and exits 0.
"""
import sys
import time

try:
    import torch
except ImportError:
    print("# torch is not installed: no peer figure")
    sys.exit(0)

OBSERVATIONS, HIDDEN, BRANCHES, ROWS, EPOCHS = 14, 128, (3, 3, 3, 2), 10240, 5


def network(outputs, gain):
    layers = [torch.nn.Linear(OBSERVATIONS, HIDDEN), torch.nn.Tanh(), torch.nn.Linear(HIDDEN, HIDDEN),
              torch.nn.Tanh(), torch.nn.Linear(HIDDEN, outputs)]
    for layer, scale in zip(layers[::2], (2 ** 0.5, 2 ** 0.5, gain)):
        torch.nn.init.orthogonal_(layer.weight, scale)
        torch.nn.init.zeros_(layer.bias)
    return torch.nn.Sequential(*layers)


def log_prob_and_entropy(logits, actions):
    log_prob, entropy = 0, 0
    for b, part in enumerate(torch.split(logits, BRANCHES, dim=1)):
        log_p = torch.log_softmax(part, dim=1)
        log_prob = log_prob + log_p.gather(1, actions[:, b:b + 1]).squeeze(1)
        entropy = entropy - (log_p.exp() * log_p).sum(1)
    return log_prob, entropy


def main():
    torch.set_num_threads(1)
    torch.manual_seed(1)
    actor, critic = network(sum(BRANCHES), 0.01), network(1, 1.0)
    parameters = list(actor.parameters()) + list(critic.parameters())
    optimiser = torch.optim.Adam(parameters, lr=3e-4, eps=1e-5)
    observations = torch.randn(ROWS, OBSERVATIONS)
    actions = torch.stack([torch.randint(0, size, (ROWS,)) for size in BRANCHES], dim=1)
    with torch.no_grad():
        old_log_probs = log_prob_and_entropy(actor(observations), actions)[0]
    advantages, returns = torch.randn(ROWS), torch.randn(ROWS)

    def epoch(minibatch):
        order = torch.randperm(ROWS)
        for first in range(0, ROWS, minibatch):
            rows = order[first:first + minibatch]
            log_probs, entropy = log_prob_and_entropy(actor(observations[rows]), actions[rows])
            ratio = (log_probs - old_log_probs[rows]).exp()
            advantage = advantages[rows]
            advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
            policy_loss = -torch.min(ratio * advantage, ratio.clamp(0.8, 1.2) * advantage).mean()
            value_loss = (critic(observations[rows]).squeeze(1) - returns[rows]).square().mean()
            loss = policy_loss - 5e-3 * entropy.mean() + 0.5 * value_loss
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(parameters, 0.5)
            optimiser.step()

    print(f"# torch {torch.__version__}, {torch.get_num_threads()} thread")
    for minibatch in (64, 256, 1024):
        best = float("inf")
        for _ in range(EPOCHS):
            start = time.process_time()
            epoch(minibatch)
            best = min(best, time.process_time() - start)
        suffix = "" if minibatch == 256 else f".minibatch_{minibatch}"
        print(f"ppo.torch_us_per_sample_epoch{suffix} {best * 1e6 / ROWS:.3f} us")
    return 0


if __name__ == "__main__":
    sys.exit(main())
