"""What a stranger can find out about a learner with nothing but its address: argv[1], HOST:PORT."""
import sys

import grpc
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from grpc_reflection.v1alpha.proto_reflection_descriptor_database import ProtoReflectionDescriptorDatabase

with grpc.insecure_channel(sys.argv[1]) as channel:
    database = ProtoReflectionDescriptorDatabase(channel)
    pool = DescriptorPool(database)
    for name in sorted(database.get_services()):
        print("service", name)

    def call(service, method, **fields):
        """Calls a unary method whose types are known from reflection alone."""
        found = pool.FindServiceByName(service).FindMethodByName(method)
        request, answer = GetMessageClass(found.input_type), GetMessageClass(found.output_type)
        unary = channel.unary_unary(f"/{service}/{method}", request.SerializeToString, answer.FromString)
        return unary(request(**fields), timeout=10)

    print("health", call("grpc.health.v1.Health", "Check").status)
    status = call("herd.v1.Training", "GetStatus")
    print("target", status.episodes_target, status.phase)
