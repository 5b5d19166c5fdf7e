"""The network as it is trained: with batch normalisation, which an exported model has folded into its convolutions."""
import json

import torch
import torch.nn as nn
import torch.nn.functional as F

from recipe import InputError
from reference import PATCH, Network, read_safetensors, write_safetensors

# mean and std by model.normalisation: the paper's, of pixels in [0, 1]; none where the image gives them
NORMALISATION = {'fixed': ([0.4914, 0.4822, 0.4465], [0.2023, 0.1994, 0.2010]), 'image': ([0.0] * 3, [1.0] * 3)}


class BatchNorm(nn.BatchNorm2d):
    """Batch normalisation, or only a scale and a bias to train, in layers that began as those of a model file: what divided
    them is folded into their weights, and is not in the file."""

    def fix(self, bias):
        self.running_mean.zero_(), self.running_var.fill_(1 - self.eps)
        self.weight.fill_(1), self.bias.copy_(bias)
        self.num_batches_tracked.fill_(-1)  # is kept in checkpoints

    def forward(self, x):
        if self.num_batches_tracked < 0:
            return F.batch_norm(x, self.running_mean, self.running_var, self.weight, self.bias, eps=self.eps)
        return super().forward(x)


def convolution(cin, cout, dilation):
    return nn.Sequential(nn.Conv2d(cin, cout, 3, padding=dilation, dilation=dilation, bias=False), BatchNorm(cout),
                         nn.ELU(inplace=True))


class Layers(nn.Sequential):
    """Layers that compute in bfloat16 while they train, if asked to. What goes in and comes out has full precision: maps that
    are compared to a hundredth of a pixel must not be rounded to eight bits."""

    def __init__(self, layers, bfloat16):
        super().__init__(*layers)
        self.bfloat16 = bfloat16

    def forward(self, x):
        with torch.autocast(x.device.type, torch.bfloat16, enabled=self.bfloat16 and self.training):
            return super().forward(x).to(x.dtype)


class TrainedNetwork(Network):
    """`model` of a recipe: encoder_channels and encoder_dilations, a list a level, finest first; m_estimator_channels and
    m_estimator_dilations, empty for none; normalisation, fixed or image. Runs as Network does."""

    def __init__(self, model, bfloat16=False):
        nn.Module.__init__(self)
        self.model, self.normalisation = model, model['normalisation']
        for name, values in zip(('mean', 'std'), NORMALISATION[self.normalisation]):
            self.register_buffer(name, torch.tensor(values).view(1, -1, 1, 1), persistent=False)
        self.levels, cin = nn.ModuleList(), 3
        for channels, dilations in zip(model['encoder_channels'], model['encoder_dilations']):
            layers = []
            for cout, dilation in zip(channels, dilations):
                layers.append(convolution(cin, cout, dilation))
                cin = cout
            self.levels.append(Layers(layers, bfloat16))
        layers, cin = [], 4
        for cout, dilation in zip(model['m_estimator_channels'], model['m_estimator_dilations']):
            layers.append(convolution(cin, cout, dilation))
            cin = cout
        self.m_estimator = Layers([*layers, nn.Sigmoid()], bfloat16) if layers else None
        self.to(memory_format=torch.channels_last)  # 1.5 times as fast on a CPU


def convolutions(network):
    """Lists of layers by place: each level of the encoder, and the M-estimator."""
    parts = [*network.levels, network.m_estimator or []]
    return [[layer for layer in part if isinstance(layer, nn.Sequential)] for part in parts]


@torch.no_grad()
def take_model(network, path):
    """Weights of a model file, of every layer that has the same shape and place; the others stay as they are. A layer that is
    taken gives what it gives in the model, in training too. -> what was taken, in words."""
    metadata, _ = read_safetensors(path)
    given, _ = Network.load(path)
    if given.normalisation != network.normalisation:
        raise InputError(f'{path}: its input normalisation is {given.normalisation}, in the recipe {network.normalisation}; '
                         f'--set model.normalisation={given.normalisation}')
    first = given.levels[0][0][0]
    if first.in_channels == 3:  # it sees numbers of another mean and deviation
        mean, std = network.mean.cpu(), network.std.cpu()
        first.bias += (first.weight * ((mean - given.mean) / given.std)).sum((1, 2, 3))
        first.weight *= std / given.std
    wanted, sources, taken = convolutions(network), convolutions(given), 0
    encoders = zip(wanted[:-1], sources[:-1])
    for layer, source in (pair for parts in (*encoders, (wanted[-1], sources[-1])) for pair in zip(*parts)):
        conv, of = layer[0], source[0]
        if (of.weight.shape, of.dilation) == (conv.weight.shape, conv.dilation):
            conv.weight.copy_(of.weight)
            layer[1].fix(of.bias)
            taken += 1
    if taken == 0:
        raise InputError(f'{path}: none of its layers has the same shape in the recipe; its encoder is '
                         f'{metadata["encoder_channels"]} (model.encoder_channels)')
    return (f'{taken} of {sum(map(len, wanted))} layers began as those of {metadata["name"]}: '
            f'{metadata.get("provenance", "")}')


def folded(layers):
    """(weight, bias) of each convolution with its batch normalisation: BN(W x) = s W x + (beta - s mu),
    s = gamma / sqrt(var + eps). In double precision, rounded once."""
    out = []
    for layer in layers:
        if isinstance(layer, nn.Sequential):
            conv, bn = layer[0], layer[1]
            s = bn.weight.double() / torch.sqrt(bn.running_var.double() + bn.eps)
            out.append(((conv.weight.double() * s.view(-1, 1, 1, 1)).float(),
                        (bn.bias.double() - bn.running_mean.double() * s).float()))
    return out


def export(network, path, name, licence, provenance, iterations, damping, carry):
    """Writes a model file of iclk (align/model_file.h), whole or not at all."""
    model, tensors = network.model, {}
    networks = {'encoder': [layer for level in network.levels for layer in level], 'm_estimator': network.m_estimator or []}
    for prefix, layers in networks.items():
        for i, (weight, bias) in enumerate(folded(layers)):
            tensors[f'{prefix}.{i}.weight'], tensors[f'{prefix}.{i}.bias'] = weight.cpu(), bias.cpu()
    mean, std = NORMALISATION[model['normalisation']]
    metadata = {'format': 'iclk-model-1', 'name': name, 'licence': licence, 'provenance': provenance, 'input_channels': '3',
                'mean': json.dumps(mean), 'std': json.dumps(std), 'activation': 'elu', 'patch': str(PATCH),
                'iterations': str(iterations), 'damping': repr(damping), 'carry': repr(carry)}
    if model['normalisation'] != 'fixed':  # what a file without the key has
        metadata['normalisation'] = model['normalisation']
    for key in ('encoder_channels', 'encoder_dilations', 'm_estimator_channels', 'm_estimator_dilations'):
        if model[key]:
            metadata[key] = json.dumps(model[key])
    write_safetensors(path, metadata, tensors)
