// An organ, held at its back, sags and is pulled at its tip: a program for a console.
//
//     make shared                                      (in the root: build/libsoftbody.so)
//     mcs -unsafe Pull.cs Organ.cs Softbody.cs && MONO_PATH=. LD_LIBRARY_PATH=../../build mono Pull.exe [ORGAN.vtk [SCALE]]
using System;
using System.Globalization;
using Softbody;

static unsafe class Pull
{
    static int Main(string[] arguments)
    {
        if (arguments.Length == 1 && arguments[0] == "--sizes")
            return PrintSizes();
        try
        {
            double scale = arguments.Length > 1 ? double.Parse(arguments[1], CultureInfo.InvariantCulture) : 1;
            Run(arguments.Length > 0 ? arguments[0] : "", scale);
            return 0;
        }
        catch (SoftbodyException error)
        {
            Console.Error.WriteLine("Pull: " + error.Message);
            return 1;
        }
    }

    static void Run(string path, double scale)
    {
        sb_vec3 gravity;
        gravity.x = gravity.y = 0;
        gravity.z = -9.81;
        using (Organ organ = new Organ(path, scale, 8000, 0.45, 1060, gravity))
        {
            int tip = 0;
            double low = double.MaxValue, high = double.MinValue;
            for (int i = 0; i < organ.NodeCount; i++)
            {
                double y = organ.RestPositions[i].y;
                if (y < low)
                    tip = i;
                low = Math.Min(low, y);
                high = Math.Max(high, y);
            }
            organ.Hold(Behind(organ, high - (high - low) / 3));
            for (int frame = 0; frame <= 60; frame++)
            {
                sb_vec3 place = organ.RestPositions[tip];
                place.y -= 0.0005 * frame;
                organ.Place(new[] { tip }, new[] { place });
                string message;
                if (!organ.Step(1.0 / 60, out message))
                    Console.Error.WriteLine("frame " + frame + ": " + message);
            }
            Console.WriteLine(string.Format(CultureInfo.InvariantCulture, "{0} nodes, {1} triangles; pulled by 30 mm it takes {2:0.00} N",
                organ.NodeCount, organ.Triangles().Length / 3, -organ.Reactions[tip].y));
        }
    }

    static int[] Behind(Organ organ, double y)
    {
        var nodes = new System.Collections.Generic.List<int>();
        for (int i = 0; i < organ.NodeCount; i++)
            if (organ.RestPositions[i].y > y)
                nodes.Add(i);
        return nodes.ToArray();
    }

    // Of every struct of the headers, for the tests.
    static int PrintSizes()
    {
        foreach (Type type in typeof(Native).Assembly.GetTypes())
            if (type.IsValueType && !type.IsEnum && !type.IsNested && type.Namespace == "Softbody" && type.GetFields().Length > 0)
                Console.WriteLine(type.Name + " " + System.Runtime.InteropServices.Marshal.SizeOf(type));
        return 0;
    }
}
